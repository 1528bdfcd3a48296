"""The map of disparity: at each pixel how far apart left and right show it, by any opening."""

import math

import numpy as np
import pytest
import torch
from command_line import read_exr, succeed, write_exr
from measures import centroid

from defocus_core import Aperture, DualPixel, PupilImage, render

SIDE = 96  # px of a square of the frame with one light in its middle
SIZE = SIDE, 3 * SIDE
OPENINGS = [
    *(Aperture(blades, rotation) for blades in (3, 5, 8) for rotation in (0.0, 37.0)),
    Aperture(),
    Aperture(7, 20.0, curvature=0.6),
    Aperture(6, obstruction=0.5, squeeze=1.6),
    Aperture(spherical=0.5),
    Aperture(5, 90.0, spherical=-0.7),
    Aperture(image=PupilImage(torch.tensor([[1.0, 1, 0], [1, 0, 0], [1, 1, 1], [1, 0, 0]]))),
]
SENSORS = [DualPixel(), DualPixel("smooth"), DualPixel("split", 0.2), DualPixel("@pixel4")]


def light(height, width, side=SIDE):
    """A soft light in the middle of each square of a picture [H, W]."""
    y, x = (np.arange(n, dtype=np.float32) % side - side // 2 for n in (height, width))
    return np.exp(-(x[None, :] ** 2 + y[:, None] ** 2) / 4)


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: f"{s.model}-{s.crosstalk:g}")
@pytest.mark.parametrize("r", [20.0, -20.0])
def test_left_and_right_are_as_far_apart_as_their_centroids_in_the_opening(sensor, r):
    image, radius = torch.from_numpy(light(64, 64, 64))[None], torch.full((64, 64), r)
    for opening in OPENINGS:
        views = render(image, radius, aperture=opening, left_right=True, dual_pixel=sensor)
        apart = centroid(views.right)[0] - centroid(views.left)[0]
        assert r * sensor.disparity(opening, nearer=r < 0) == pytest.approx(apart, rel=0.01)


def test_half_discs_are_as_far_apart_as_calculus_says():
    assert DualPixel().disparity(Aperture()) == pytest.approx(8 / (3 * math.pi), rel=1e-6)


@pytest.mark.parametrize("metres", [1.3, 60])  # 15 px nearer than the focus, 21 px beyond
@pytest.mark.parametrize(
    "opening",
    [
        ("--blades", "5"),
        ("--spherical", "0.5"),
        ("--cat-eye", "1.05:1.5"),
        ("--cat-eye", "0.9:2", "--blades", "3", "--blade-rotation", "37", "--spherical", "-0.4"),
        ("--dp-model", "smooth", "--dp-crosstalk", "0.1", "--squeeze", "1.5", "--blades", "6"),
    ],
    ids="".join,
)
def test_the_map_holds_what_left_and_right_show_at_the_place(opening, metres, tmp_path):
    color = write_exr(tmp_path / "a.exr", **dict.fromkeys("RGB", light(*SIZE)))
    depth = write_exr(tmp_path / "z.exr", Z=np.full(SIZE, metres, np.float32))
    lens = ("--focal-length", "150mm", "--fnumber", "2", "--focus", "2.2m", *opening)
    outputs = ("--outputs", "left,right,disparity", "--exr-type", "float")
    succeed("render", *lens, color, depth, "-o", tmp_path / "o", *outputs)
    kinds = {"left": "G", "right": "G", "disparity": "disparity"}
    planes = [read_exr(tmp_path / "o" / kind / "a.exr")[name] for kind, name in kinds.items()]
    for square in np.split(np.arange(SIZE[1]), 3):
        left, right, said = (plane[:, square] for plane in planes)
        apart = centroid(right)[0] - centroid(left)[0]
        assert said[SIDE // 2, SIDE // 2] == pytest.approx(apart, rel=0.01)
