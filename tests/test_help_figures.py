"""Figures of the help that are measurements are what a run measures."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import read_exr, run, write_exr
from measures import centroid
from renderers import HAS_LOOPS

from defocus_core import Aperture, DualPixel, render

ROOT = Path(__file__).parents[1]
TEXT = {path.stem: path.read_text() for path in (ROOT / "defocus_cli" / "help").glob("*.md")}
BANDS = re.findall(r"^\| (\S+) to (\S+) px \| (\S+) px \| (\S+) px \|$", TEXT["quality"], re.M)
SIDE = 192  # px


def figure(topic, words):
    """The number in some words of a topic, whose lines may break anywhere."""
    pattern = re.escape(words).replace(r"\ ", r"\s+").replace("N", r"([\d.]+)")
    (found,) = re.findall(pattern, TEXT[topic])
    return float(found)


def lights(at, sigma=2**0.5, size=(SIDE, SIDE)):
    """A soft light at a column and row."""
    y, x = np.mgrid[: size[0], : size[1]] - np.reshape(at, (2, 1, 1))[::-1]
    return np.exp(-(x**2 + y**2) / (2 * sigma**2)).astype(np.float32)


SOFT_ON_GREY, PIXEL_ON_BLACK = (2**0.5, 0.5), (0.1, 0.0)


def lost(r, light=(2**0.5, 0.0), aperture=Aperture()):  # noqa: B008
    """How much less disparity left and right show of a light than the map says, px.

    `light`: its deviation in px, and what it stands on.
    """
    sigma, base = light
    image = torch.from_numpy(base + (1 - base) * lights((SIDE // 2, SIDE // 2), sigma))[None]
    views = render(*(image, torch.full(image.shape[1:], r)), aperture=aperture, left_right=True)
    left, right = (centroid(view[0].double() - base)[0] for view in views.images[1:])
    return abs(r * DualPixel().disparity(aperture) - (right - left))


@pytest.mark.parametrize(("low", "high", "soft", "lone"), BANDS)
def test_left_and_right_lose_as_much_as_the_table_says(low, high, soft, lone):
    said = {SOFT_ON_GREY: soft, PIXEL_ON_BLACK: lone}
    radii = np.linspace(float(low), float(high), 9)[1:].tolist()
    measured = {case: max(lost(r, case) for r in radii) for case in said}
    told = {case: float(text) for case, text in said.items()}
    for case, most in told.items():
        assert measured[case] < most + 0.006
    if HAS_LOOPS:  # the table is of the back that most pictures are rendered by
        assert measured == pytest.approx(told, abs=0.006)


def test_sampled_kernels_show_as_much_less_as_is_said():
    at_3 = 3 * DualPixel().disparity(Aperture())
    assert 100 * lost(3.0) / at_3 == pytest.approx(figure("look", "px, N % at 3 px"), abs=0.5)
    said = figure("look", "of five blades N %")
    assert 100 * lost(3.0, aperture=Aperture(5)) / at_3 == pytest.approx(said, abs=0.5)
    assert all(lost(r) * r == pytest.approx(0.09, abs=0.02) for r in (2.0, 4.0, 8.0, 16.0))


def test_the_line_of_compare_is_one_that_it_prints(here):
    picture = read_exr(ROOT / "sample_scenes/spheres/rgb.exr")
    write_exr(Path("golden/render/rgb.exr"), **picture)
    moved = {name: np.roll(plane, 1, 1) for name, plane in picture.items()}
    write_exr(Path("new/render/rgb.exr"), **moved)
    line = run("compare", "golden", "new").out.splitlines()[0]
    assert line in " ".join(TEXT["compare"].split())
