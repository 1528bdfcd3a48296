"""What the depth decides of a lens: the focus at a percentile."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from command_line import color_exr, depth_exr, header, run
from depth_reading import depth_of
from jobs_files import lens_values
from refusals import refuses

from defocus_core.picture.focus import with_focus
from defocus_core.picture.radii import radii_of

LENS = lens_values()


def at(percent):
    return replace(LENS, foc_dist=None, focus_percentile=percent)


@pytest.mark.parametrize(
    ("percent", "metres"), [(0, 1), (25, 1), (26, 2), (50, 2), (51, 5), (100, 5)]
)
def test_a_percentile_is_the_distance_of_a_pixel_sky_and_holes_aside(percent, metres):
    depth = depth_of(np.array([[1, 2, 5, 5], [math.inf, math.inf, math.nan, 0]]))
    assert with_focus(at(percent), depth).foc_dist == metres * 1000


def test_where_all_is_sky_there_is_nothing_to_focus_on():
    with refuses("no-valid-depth") as caught:
        with_focus(at(50), depth_of(np.full((2, 2), math.inf)))
    assert pickle.loads(pickle.dumps(caught.value)).code == "no-valid-depth"


def test_a_percentile_nearer_than_the_focal_length_is_refused():
    with refuses("focus-too-near", "40mm"):
        with_focus(at(50), depth_of(np.full((2, 2), 0.04)))


def test_the_focus_of_a_percentile_is_written_down(tmp_path):
    color, depth = color_exr(tmp_path / "a.exr"), depth_exr(tmp_path / "z.exr")
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "percentile(100)")
    ran = run("render", color, depth, "-o", tmp_path / "out", "--json", *lens)
    assert ran.json["pictures"][0]["lens"]["focus_mm"] == 4000
    assert "focus 4m at percentile(100)" in ran.err
    assert header(tmp_path / "out" / "render" / "a.exr")["defocus:focus"] == "4m"


@pytest.mark.parametrize("focus", [50.000001, 50.00001])
def test_a_focus_hardly_beyond_the_focal_length_is_refused(focus):
    with refuses("out-of-range"):
        radii_of(replace(LENS, foc_dist=focus), depth_of(np.full((2, 300), 5.0)))
