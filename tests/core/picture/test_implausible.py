"""Depth in a wrong unit, or a disparity taken for a distance, is told; plausible depth is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from depth_reading import depth_of
from jobs_files import lens_values

from defocus_core.picture.focus import with_blur_reach
from defocus_core.picture.radii import of_file, of_radii, radii_of

LENS = lens_values()
SCENE = np.geomspace(1.0, 40.0, 320 * 240).reshape(240, 320)  # m


def warnings(metres, lens=LENS, *, path="depth.exr", declared=False, **more):
    depth = depth_of(metres, path, more.get("channel", "Z"))
    radius, ends, *_ = radii_of(lens, depth)
    words = of_radii(depth, radius, ends, lens, declared=declared)
    return (*words, *of_file(depth, declared=declared))


@pytest.mark.parametrize("foclen", [24.0, 50.0, 85.0])
@pytest.mark.parametrize("focus", [1000.0, 2000.0, 8000.0, math.inf])
def test_a_lens_focused_in_the_scene_or_at_infinity_is_not_doubted(foclen, focus):
    assert not warnings(SCENE, lens_values(foclen, 2.0, focus))


def test_sky_beside_what_is_in_focus_is_not_doubted():
    metres = np.full((240, 320), math.inf)
    metres[:3] = 2.0
    assert not warnings(metres)


def test_centimetres_taken_for_metres_leave_nothing_in_focus():
    (line,) = warnings(SCENE * 100)
    assert "nothing is in focus at 2m: depth goes from 100m to 4000m" in line
    assert line.endswith("check ‹depth-unit› and ‹focus›")


@pytest.mark.parametrize("number", [0, 255, 300, 400])
def test_a_number_beyond_those_of_the_file_is_not_in_focus(number):
    numbers = np.linspace(0, 255, 48, dtype=np.float32).reshape(6, 8)
    depth = depth_of(numbers, "d.png", "", is_radius=True, is_relative=True)
    lens = with_blur_reach(
        lens_values(math.nan, math.nan, None, blur=30.0, focus_value=number), [depth]
    )
    radius, ends, *_ = radii_of(lens, depth)
    lines = list(of_radii(depth, radius, ends, lens, declared=True))
    assert bool(lines) == (number > 255)
    if lines:
        assert f"nothing is in focus at the number {number}: numbers go from 0 to 255" in lines[0]


def test_metres_taken_for_millimetres_lie_nearer_than_the_focal_length():
    (line,) = warnings(SCENE / 1000)
    assert "nearer than the focal length 50mm in 76800 pixels" in line


def test_a_blur_wider_than_the_picture_is_told():
    metres = SCENE.copy()
    metres[0, 0] = 0.06
    (line,) = warnings(metres, lens_values(50.0, 1.0, 2000.0))
    assert "wider than the picture" in line
    assert "depth goes from 60mm to 40m" in line


def test_a_focus_in_a_gap_of_the_scene_is_told():
    (line,) = warnings(np.where(SCENE < 3, 1.0, 20.0))
    assert "nothing is in focus at 2m: depth goes from 1m to 20m" in line


def test_all_sky_has_no_range():
    (line,) = warnings(np.full((240, 320), math.inf))
    assert "nowhere but to the sky" in line


def test_whoever_declared_the_unit_is_not_asked_to_declare_it():
    (line,) = warnings(SCENE * 100, declared=True)
    assert line.endswith("check the declared format or unit and ‹focus›")


@pytest.mark.parametrize(
    ("path", "channel", "name"),
    [
        ("a.exr", "FinalImageMovieRenderQueue_WorldDepth.R", "unreal-mrq"),
        ("frame.0000.depth_meters.hdf5", "dataset", "hypersim"),
    ],
)
def test_a_channel_that_one_program_writes_is_told_with_its_format(path, channel, name):
    (line,) = warnings(SCENE, path=path, channel=channel)
    assert f"‹depth-format› {name}" in line
    assert not warnings(SCENE, path=path, channel=channel, declared=True)
    assert not warnings(SCENE, path="depth.npz", channel="dataset")
