"""Pairs that no lens explains are refused for what they are, on all sample scenes."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from defocus_core import Aperture, DualPixel, fit, read_color, read_depth, render
from defocus_core.fitting.refusals import JudgedPair, refusals_of
from defocus_core.fitting.residual import Optics, Residual, error_of
from defocus_core.fitting.unknowns import Candidate

SCENES = Path(__file__).parents[3] / "sample_scenes"
NAMES = ("floor", "layered", "leaves", "lights", "spheres")
NOTHING = {"shift": False, "exposure": False, "gamma": False}
OPTIONS = {"‹shift›", "‹exposure›", "‹gamma›"}
REFUSED = {"not-one-scene", "not-explained"}


@cache
def scene(name, width):
    """Light [3, H, W] and disparity [H, W] of a sample scene at a width."""
    planes = read_color(SCENES / name / "rgb.exr").light
    light = torch.from_numpy(np.stack([plane[:] for plane in planes], dtype="float32"))
    metres = read_depth(SCENES / name / "depth.exr").metres[:]
    disparity = 1 / torch.from_numpy(np.array(metres, "float32"))
    size = round(width * light.shape[1] / light.shape[2]), width
    small = interpolate(light[None], size, mode="area")[0]
    return small, interpolate(disparity[None, None], size, mode="nearest")[0, 0]


def lens(disparity, maximum):
    """Focus on the middle of the disparities, and the greatest radius in px."""
    focus = float(disparity.median())
    return Candidate(maximum / float((focus - disparity).abs().max()), focus)


@cache
def blurred(name, width):
    light, disparity = scene(name, width)
    point = lens(disparity, width / 30)
    return light, disparity, render(light, point.strength * (point.focus - disparity)).render, point


def unrelated(light, _, name):
    other = blurred(NAMES[NAMES.index(name) - 1], light.shape[2])[2]
    return interpolate(other[None], light.shape[1:], mode="area")[0]


def cropped(_, observed, __):
    height, width = observed.shape[1:]
    part = observed[None, :, height // 10 : -height // 10, width // 10 : -width // 10]
    return interpolate(part, (height, width), mode="bilinear")[0]


HOSTILE: dict[str, tuple[Callable[[Tensor, Tensor, str], Tensor], set[str]]] = {
    "shifted": (lambda _, observed, __: observed.roll((1, -2), (1, 2)), {"‹shift›"}),
    "unrelated": (unrelated, REFUSED),
    "gamma": (lambda _, observed, __: observed.clamp(min=0) ** 0.7, {"‹gamma›"}),
    "brighter": (lambda _, observed, __: 1.4 * observed, {"‹exposure›"}),
    "cropped": (cropped, {*REFUSED, "‹shift›"}),  # a floor that is cropped is nearly moved
    "mirrored": (lambda _, observed, __: observed.flip(2), {*REFUSED, *OPTIONS}),
    "upside down": (lambda _, observed, __: observed.flip(1), {*REFUSED, *OPTIONS}),
}


def said(refusals):
    """The option that a refusal proposes, or its code; nothing where there is none."""
    for code, _, remedy in refusals:
        return remedy.removeprefix("add ") if code == "other-cause" else code
    return ""


def judged(sharp, disparity, observed, point):
    """What is said of a point of a pair."""
    residual = Residual(sharp, disparity, (observed,), exposure=False)
    evidence = JudgedPair.of(residual, point, Optics(Aperture(), DualPixel()))
    return said(list(refusals_of(evidence, NOTHING, point)))


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("strength", [0.02, 1.0, 4.0])
def test_a_hostile_pair_is_refused_by_the_right_lens_and_by_hardly_any(kind, strength):
    change, wanted = HOSTILE[kind]
    for name in NAMES[kind == "mirrored" :]:  # the floor is its own mirror image, nearly
        light, disparity, observed, point = blurred(name, 80)
        found = Candidate(strength * point.strength, point.focus)
        assert judged(light, disparity, change(light, observed, name), found) in wanted, name


def test_a_sharp_picture_in_the_place_of_the_blurred_one_is_refused():
    for name in NAMES:
        light, disparity, observed, point = blurred(name, 80)
        assert judged(observed, disparity, light, point) in {*REFUSED, *OPTIONS}, name


@pytest.mark.parametrize("change", [{"across": 16.0}, {"down": -16.0}, {"magnification": 1 / 1.02}])
def test_a_registration_at_the_end_of_its_range_is_refused(change):
    light, disparity, observed, point = blurred("leaves", 120)
    residual = Residual(light, disparity, (observed,), exposure=False)
    evidence = JudgedPair.of(residual, point, Optics(Aperture(), DualPixel()))
    asked = {**NOTHING, "shift": True}
    assert said(list(refusals_of(evidence, asked, replace(point, **change)))) == "out-of-range"
    assert not list(refusals_of(evidence, asked, point))


def test_the_right_lens_leaves_no_difference_of_a_clean_pair():
    for name in NAMES:
        light, disparity, observed, point = blurred(name, 80)
        residual = Residual(light, disparity, (observed,), exposure=False)
        there = residual.of(point, Optics(Aperture(), DualPixel()), residual.scale(None))
        assert error_of(*there) < 1e-12, name


def test_the_right_lens_is_not_refused():
    for name in NAMES:
        light, disparity, observed, point = blurred(name, 80)
        assert not judged(light, disparity, observed, point), name
        assert not judged(
            light, disparity, observed.clamp(max=float(observed.quantile(0.8))), point
        ), name


@pytest.mark.bench
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", HOSTILE)
def test_the_fit_of_a_hostile_pair_is_refused(name, kind):
    light, disparity, observed, _ = blurred(name, 240)
    change, wanted = HOSTILE[kind]
    if kind == "gamma":
        wanted = wanted | {"‹exposure›"}  # of lamps alone a factor explains as much
    assert said(list(fit(light, disparity, change(light, observed, name)).refusals)) in wanted


@pytest.mark.bench
@pytest.mark.parametrize("name", NAMES)
def test_ten_lenses_of_a_scene_are_found(name):
    generator = torch.Generator().manual_seed(5)
    light, disparity = scene(name, 480)
    nearest = float(disparity.max())
    for _ in range(10):
        rank, size = torch.rand(2, generator=generator).tolist()
        focus = float(disparity.flatten().sort().values[int(rank * (disparity.numel() - 1))])
        away = float((focus - disparity).abs().flatten().kthvalue(int(0.99 * disparity.numel()))[0])
        strength = 3 * 10**size / away  # the 99th percentile of the radii is 3 to 30 px
        found = fit(light, disparity, render(light, strength * (focus - disparity)).render)
        assert found.focus == pytest.approx(focus, rel=0.01, abs=2e-4 * nearest)  # or 0
        assert found.strength == pytest.approx(strength, rel=0.02)
