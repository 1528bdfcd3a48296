"""What a plan counts is what the renderer does."""

import math
from typing import Any

import pytest
import torch
from scenes import RADII, pattern
from torch import Tensor

from defocus_core import Aperture, blur, presence, reduced, render, windows
from defocus_core.aperture import parts
from defocus_core.convolution import crop_inverse, kernel_spectra
from defocus_core.planning import BYTES, LOADS, Plan, plan
from defocus_core.quality import find
from defocus_core.scenery import KINDS, scenery
from defocus_core.tiling import Box

COUNTS = ("slices", "tiles", "slice_tiles", "slice_tiles_done", "tiles_with_hidden")
SIZE = (200, 300)


def counts(found: Plan) -> dict[str, int]:
    return {name: getattr(found, name) for name in COUNTS}


def done(image: Tensor, radius: Tensor, quality: str = "standard") -> dict[str, int]:
    stats = render(image, radius, quality=quality).stats
    found = {name: stats[name] for name in COUNTS}
    found["slice_tiles_done"] += stats["slice_tiles_culled"]  # a plan doesn't know what covers
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_a_small_frame_is_planned_as_it_is_rendered(kind: str, quality: str) -> None:
    image, radius = scenery(kind, *SIZE, 8.8)  # not on a rung
    planned = plan(radius, image=image, quality=quality)
    assert counts(planned) == done(image, radius, quality)
    assert set(planned.loads) == set(LOADS)
    assert set(planned.bytes) == set(BYTES)


@pytest.mark.parametrize("kind", RADII)
def test_strange_depths_are_planned_nearly_as_they_are_rendered(kind: str) -> None:
    image, radius = pattern(SIZE), RADII[kind](SIZE)
    planned, rendered = counts(plan(radius)), done(image, radius)
    for name in COUNTS:
        assert planned[name] == pytest.approx(rendered[name], rel=0.15), name


@pytest.mark.parametrize("kind", ["floor", "cards", "thin"])
def test_a_sample_of_a_large_frame_tells_nearly_the_same(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, radius = scenery(kind, 512, 640, 12.0)
    whole = plan(radius)
    monkeypatch.setattr(presence, "_SAMPLE", 512 * 640 // 16)
    monkeypatch.setattr(presence, "_SAMPLE_BEHIND", 512 * 640 // 4)
    monkeypatch.setattr(presence, "_STRIP", 640 * 100)
    sampled = plan(radius)
    for name in COUNTS:
        assert getattr(sampled, name) == pytest.approx(getattr(whole, name), rel=0.12), name
    for name, load in whole.loads.items():
        assert sampled.loads[name] == pytest.approx(load, rel=0.2, abs=1), name


def loads(
    quality: str = "standard", *, left_right: bool = False, r: float = 9.0
) -> dict[str, float]:
    _, radius = scenery("cards", *SIZE, r)
    return plan(radius, quality=quality, left_right=left_right).loads


def test_more_is_planned_for_a_pair_and_for_more_parts_of_the_aperture() -> None:
    centre, pair, high = loads(), loads(left_right=True), loads("high")
    assert pair["products"] == 3 * centre["products"]
    assert pair["forward"] == centre["forward"]
    assert high["inverse"] > 4 * centre["inverse"]
    assert len(parts(Aperture(), find("high").parts)) == 4


def test_hidden_content_and_edges_are_planned_where_surfaces_overlap() -> None:
    assert loads()["behind"] > 0 < loads()["edges"]
    _, floor = scenery("floor", *SIZE, 9.0)
    assert plan(floor).loads["behind"] == 0 == plan(floor).loads["edges"]


@pytest.mark.parametrize(
    ("kind", "r", "quality"),
    [
        ("plane", 60.0, "draft"),
        ("floor", 60.0, "high"),
        ("cards", 60.0, "draft"),
        ("cards", 9.0, "standard"),
        ("thin", 40.0, "standard"),
        ("most", 30.0, "standard"),
    ],
)
def test_what_is_transformed_back_is_planned(
    kind: str, r: float, quality: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, radius = scenery(kind, *SIZE, r)
    planned = plan(radius, image=image, quality=quality)
    found = []

    def counted(spectrum: Tensor, window: tuple[int, int], box: Box) -> Any:
        area = math.prod(window)
        found.append(math.prod(spectrum.shape[:-2]) * area * math.log2(area))
        return crop_inverse(spectrum, window, box)

    monkeypatch.setattr(blur, "crop_inverse", counted)
    monkeypatch.setattr(reduced, "crop_inverse", counted)
    render(image, radius, quality=quality)
    assert planned.loads["inverse"] == pytest.approx(sum(found), rel=0.1)


def test_spectra_of_kernels_are_planned_as_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    image, radius = scenery("cards", *SIZE, 60.0)
    found = []

    def counted(kernels: Tensor, size: tuple[int, int]) -> Tensor:
        spectra = kernel_spectra(kernels, size)
        found.append(spectra.shape[:-1].numel() * size[1])
        return spectra

    monkeypatch.setattr(windows, "kernel_spectra", counted)
    render(image, radius)
    assert plan(radius, image=image).bytes["spectra"] == pytest.approx(4 * sum(found), rel=0.1)


def test_planes_take_fewer_transforms_than_what_is_bent() -> None:
    """Kernels are tilted instead of them."""
    _, floor = scenery("floor", 256, 256, 40.0)
    y = torch.linspace(0, 1, 256)[:, None]
    bent = floor + 2 * torch.sin(6 * math.pi * y) + 0 * floor
    straight, curved = (plan(r).loads for r in (floor, bent))
    assert straight["forward"] < 0.6 * curved["forward"]
    assert straight["averaged"] < 0.6 * curved["averaged"]


def test_small_radii_are_not_averaged() -> None:
    assert loads(r=9.0)["averaged"] == 0 < loads(r=60.0)["averaged"]


def test_lights_are_planned_where_the_picture_has_some() -> None:
    image, radius = scenery("lights", *SIZE, 9.0)
    assert plan(radius, image=image).loads["lights"] > 1000
    assert plan(radius).loads["lights"] == 0
    dim, _ = scenery("thin", *SIZE, 9.0)
    assert plan(radius, image=dim).loads["lights"] == 0


def test_a_picture_of_great_range_takes_twice_the_bytes() -> None:
    image, radius = scenery("floor", *SIZE, 9.0)
    bright = image.clone()
    bright[:, :20] *= 1e5
    wide, usual = plan(radius, image=bright), plan(radius, image=image)
    assert wide.bytes["spectra"] == 2 * usual.bytes["spectra"]
    assert wide.loads["forward"] == 2 * usual.loads["forward"]


def test_what_is_no_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="signed_radius must be"):
        plan(torch.zeros(1, 4, 4))
    with pytest.raises(ValueError, match="quality must be one of"):
        plan(torch.zeros(4, 4), quality="best")
