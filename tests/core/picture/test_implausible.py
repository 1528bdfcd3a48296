"""Depth in a wrong unit, or a disparity taken for a distance, is told; plausible depth is not."""

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


NEAR = SCENE.copy()
NEAR[0, 0] = 0.06


@pytest.mark.parametrize(
    ("metres", "more", "words"),
    [
        # centimetres taken for metres
        (100 * SCENE, {}, "nothing is in focus at 2m: depth goes from 100m to 4000m"),
        (100 * SCENE, {}, "check ‹depth-unit› and ‹focus›"),
        (100 * SCENE, {"declared": True}, "check the declared format or unit and ‹focus›"),
        # metres taken for millimetres
        (SCENE / 1000, {}, "nearer than the focal length 50mm in 76800 pixels"),
        (NEAR, {"lens": lens_values(50.0, 1.0, 2000.0)}, "wider than the picture"),
        (NEAR, {"lens": lens_values(50.0, 1.0, 2000.0)}, "depth goes from 60mm to 40m"),
        (np.where(SCENE < 3, 1.0, 20.0), {}, "in focus at 2m: depth goes from 1m to 20m"),
        (np.full((240, 320), math.inf), {}, "nowhere but to the sky"),
    ],
)
def test_depth_that_does_not_fit_the_lens_is_told(metres, more, words):
    (line,) = warnings(metres, **more)
    assert words in line


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
