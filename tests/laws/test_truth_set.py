"""Against path-traced truth, where a set of it lies beside the repository."""

import json
import math
from pathlib import Path
from typing import Any

import demo
import numpy as np
import OpenEXR
import pytest
import torch
from torch import Tensor

from defocus_core import DefocusLens, render

TRUTH = Path(__file__).parents[3] / "shared" / "truth"
pytestmark = pytest.mark.skipif(
    not (TRUTH / "quick" / "camera.json").exists(),
    reason="needs ../shared/truth",
)


def shot_of(scene: str, name: str) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Sharp picture [3, H, W], signed radius [H, W], and the shot."""
    camera = json.loads((TRUTH / scene / "camera.json").read_text())
    shot: dict[str, Any] = next(s for s in camera["shots"] if s["name"] == name)
    W, H, across = camera["width"], camera["height"], camera["sensor_width_mm"]
    lens = DefocusLens(camera["focal_length_mm"], shot["fnumber"], (across, across * H / W), (W, H))
    lens.refocus(1000 * shot["focus_distance_m"])
    with OpenEXR.File(str(TRUTH / scene / "depth.exr"), separate_channels=True) as file:
        depth = torch.from_numpy(file.channels()["Z"].pixels.copy())
    sharp = np.moveaxis(demo.read_rgb(TRUTH / scene / "rgb.exr"), -1, 0)
    return torch.from_numpy(sharp.copy()).float(), lens.signed_radius(1000 * depth), shot


@pytest.mark.parametrize(("suffix", "at_least"), [("", 39.5), ("_left", 36.0), ("_right", 36.0)])
def test_a_quick_scene_is_near_its_truth(suffix: str, at_least: float) -> None:
    image, radius, shot = shot_of("quick", "r12")
    o = render(image, radius, left_right=True)
    picture = {"": o.render, "_left": o.left, "_right": o.right}[suffix]
    assert picture is not None
    truth = demo.read_rgb(TRUTH / "quick" / f"truth_r12{suffix}.exr")
    border = math.ceil(shot["max_coc_radius_px"])
    rendered = np.moveaxis(picture.double().numpy(), 0, -1)
    assert demo.psnr(rendered, truth, border) > at_least


@pytest.mark.parametrize("name", ["r10", "r40"])
def test_the_white_scene_is_white(name: str) -> None:
    image, radius, _ = shot_of("white", name)
    o = render(image, radius, left_right=True)
    for picture in (o.render, o.left, o.right):
        assert picture is not None
        assert float((picture - 1).abs().max()) < 1e-3
