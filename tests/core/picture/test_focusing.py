"""What the depth decides of a lens: the focus at a percentile, and whether the blur is allowed."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import color_exr, depth_exr, header, ramp, refused, run
from refusals import refuses

from defocus_core.errors import Rejected
from defocus_core.io.arrays import IN_MEMORY
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.optics.distributions import ATTEMPTS
from defocus_core.picture.focus import with_focus
from defocus_core.picture.radii import radii_of, signed_radius
from defocus_core.request.lens import Draw, Lens
from defocus_core.request.resolver import drawn_lens

LENS = Lens(50.0, 2.0, 2000.0)


def depth_of(metres):
    planes = np.asarray(metres, np.float32)
    return Depth(planes, Path("depth.exr"), "Z", "")


def at(percent):
    return replace(LENS, foc_dist=None, focus_percentile=percent)


def reach(lens, depth):
    height, width = depth.metres.shape
    return float(np.abs(signed_radius(lens, depth.metres, (width, height))).max())


@pytest.mark.parametrize(
    ("percent", "metres"), [(0, 1), (25, 1), (26, 2), (50, 2), (51, 5), (100, 5)]
)
def test_a_percentile_is_the_distance_of_a_pixel_sky_and_holes_aside(percent, metres):
    depth = depth_of(np.array([[1, 2, 5, 5], [math.inf, math.inf, math.nan, 0]]))
    assert with_focus(at(percent), depth).foc_dist == metres * 1000


def test_where_all_is_sky_there_is_nothing_to_focus_on():
    with refuses("no-valid-depth", kind=Rejected) as caught:
        with_focus(at(50), depth_of(np.full((2, 2), math.inf)))
    assert pickle.loads(pickle.dumps(caught.value)).code == "no-valid-depth"


def test_a_percentile_nearer_than_the_focal_length_is_rejected():
    with refuses("focus-too-near", "40mm", kind=Rejected):
        with_focus(at(50), depth_of(np.full((2, 2), 0.04)))


def test_blur_beyond_the_maximum_is_rejected_and_blur_up_to_it_is_not():
    depth = depth_of(ramp())
    largest = reach(LENS, depth)
    assert with_focus(replace(LENS, max_coc=largest * 1.001), depth).foc_dist == 2000.0
    with refuses("coc-too-large", kind=Rejected):
        with_focus(replace(LENS, max_coc=largest * 0.999), depth)


def test_sky_counts_for_the_maximum():
    metres = ramp()
    metres[0, 0] = math.inf
    lens = replace(LENS, foc_dist=1000.0)
    largest = reach(lens, depth_of(ramp()))
    with pytest.raises(Rejected):
        with_focus(replace(lens, max_coc=largest * 1.001), depth_of(metres))


def drawn(index, fnumber, max_coc):
    options = (("focal-length", "50mm"), ("fnumber", fnumber), ("focus", "2m"), ("blades", "6"))
    return drawn_lens(Draw(7, "a", index, options), "", max_coc)


def test_a_lens_that_does_not_suit_the_picture_is_drawn_again_within_its_range():
    depth = depth_of(ramp())
    maximum = reach(replace(LENS, fnum=4.0), depth)
    lenses = [drawn(index, "loguniform(1, 16)", maximum) for index in range(20)]
    found = [with_focus(lens, depth) for lens in lenses]
    assert all(4 <= lens.fnum <= 16 and lens.blades == 6 for lens in found)
    again = [one.draw.attempt > 0 for one in found if one.draw]
    assert again == [lens.fnum < 4 for lens in lenses]
    assert any(again)
    assert found == [with_focus(lens, depth) for lens in lenses]


def test_when_no_draw_suits_the_picture_it_is_rejected():
    with refuses("coc-too-large", f"last of {ATTEMPTS} lenses", kind=Rejected):
        with_focus(drawn(0, "uniform(1, 2)", 0.01), depth_of(ramp()))


def test_the_focus_of_a_percentile_is_written_down(tmp_path):
    color, depth = color_exr(tmp_path / "a.exr"), depth_exr(tmp_path / "z.exr")
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "percentile(100)")
    ran = run("render", color, depth, "-o", tmp_path / "out", "--json", *lens)
    assert ran.json["pictures"][0]["lens"]["focus_mm"] == 4000
    assert "focus 4m at percentile(100)" in ran.err
    assert header(tmp_path / "out" / "render" / "a.exr")["defocus:focus"] == "4m"


def test_a_focus_that_is_no_percentile_is_refused(tmp_path):
    for text in ("percentile(101)", "percentile(5m)", "percentile()", "percentile(5, 95)"):
        lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", text)
        refused(run("render", "a", "b", "-o", tmp_path / "out", *lens), 2, "malformed", "focus")


@pytest.mark.parametrize("focus", [50.000001, 50.00001])
def test_a_focus_hardly_beyond_the_focal_length_is_refused(focus):
    with refuses("out-of-range"):
        radii_of(replace(LENS, foc_dist=focus), depth_of(np.full((2, 300), 5.0)), IN_MEMORY)
