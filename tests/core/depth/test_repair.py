"""Depth is repaired at one door before anything is rendered, as its diagnosis says; or not at all.

Depth that a renderer wrote comes out as the same object; pictures of it do not know the switch.
"""

import pytest
import torch
from measures import worst
from renderers import renderer_of
from synthetic_scenes import scenery

from defocus_core import DefocusLens, RandomDefocus, render, repair_depth
from defocus_core.depth.repair import diagnose_depth
from defocus_core.tensors import device_plan

SIZE, LARGE = (140, 190), (200, 260)


def noisy():
    image, radius = scenery("cards", *SIZE, 12.0)
    scatter = torch.randn(SIZE, generator=torch.Generator().manual_seed(1))
    return image, radius + 0.3 * scatter


def soft():
    image, radius = scenery("cards", *SIZE, 24.0)
    around = torch.nn.functional.pad(radius[None, None], (4, 4, 4, 4), mode="replicate")
    return image, torch.nn.functional.avg_pool2d(around, 9, stride=1)[0, 0]


def quantised(size=SIZE):
    """A slope in some hundred levels of 0.3 px."""
    image, radius = scenery("plane", *size, 12.0)
    slope = 0.1 * torch.arange(size[1]) + 0.05 * torch.arange(size[0])[:, None]
    return image, (slope / 0.3).round().to(radius) * 0.3


DAMAGED = {"noise": noisy, "soft_edges": soft, "quantised": quantised}


@pytest.mark.parametrize("damage", DAMAGED)
def test_the_record_is_the_diagnosis(damage):
    image, radius = DAMAGED[damage]()
    found, repair = repair_depth(radius, image, threads=2)
    assert getattr(repair, damage)
    assert 0 < repair.fraction <= 1
    assert repair._replace(edge_shifts=None, fraction=0.0) == diagnose_depth(radius)
    assert not torch.equal(found, radius)


@pytest.mark.parametrize("kind", ["most", "cards", "floor", "thin", "plane"])
def test_depth_of_a_renderer_needs_no_repair(kind):
    image, radius = scenery(kind, *LARGE, 12.0)
    found, repair = repair_depth(radius, image)
    assert found is radius
    assert not any(repair)
    auto, off = (render(image, radius, depth_repair=switch).render for switch in ("auto", "off"))
    assert torch.equal(auto, off)


@pytest.mark.parametrize("damage", DAMAGED)
def test_repair_is_rendering_of_repaired_depth(damage):
    image, radius = DAMAGED[damage]()
    whole, _ = repair_depth(radius, image)
    auto = render(image, radius).render
    assert torch.equal(auto, render(image, whole, depth_repair="off").render)
    assert not torch.equal(auto, render(image, radius, depth_repair="off").render)


@pytest.mark.parametrize("rows", [7, 64])
@pytest.mark.parametrize("damage", DAMAGED)
def test_bands_of_rows_decide_nothing(damage, rows, monkeypatch):
    image, radius = DAMAGED[damage]()
    whole, repair = repair_depth(radius, image)
    monkeypatch.setattr(device_plan, "_ROWS", rows)
    monkeypatch.setattr(device_plan, "_BAND_OF_MARGIN", 0)
    found, told = repair_depth(radius, image, threads=2)
    assert told == repair
    assert torch.equal(found, whole)


def test_repair_off_diagnoses_nothing():
    for make in DAMAGED.values():
        assert not any(renderer_of(*make(), depth_repair="off").repair)


def test_a_lens_takes_the_switch():
    image, radius = (x.float() for x in noisy())
    depth = 3000 / (1 + 0.03 * radius[None])
    lens = DefocusLens(
        foclen=50.0, fnum=2.0, sensor_size=(36.0, 36.0 * SIZE[0] / SIZE[1]), sensor_res=SIZE[::-1]
    )
    lens.refocus(-3000.0)
    for method in ("render_rgbd", "render_rgbd_dp"):
        pictures = [
            getattr(lens, method)(image[None], depth, depth_repair=switch)
            for switch in ("auto", "off")
        ]
        assert not torch.equal(pictures[0][0], pictures[1][0])
    auto, off = (
        RandomDefocus(foclen=50.0, fnum=1.0, foc_dist=3000.0, blades=0, depth_repair=switch)(
            image[None], depth, [1]
        )[0].render
        for switch in ("auto", "off")
    )
    assert not torch.equal(auto, off)


@pytest.mark.parametrize("seed", range(0, 20, 4))
@pytest.mark.usefixtures("torch_back")
def test_rounding_decides_nothing_beside_a_matte_on_a_slope(seed):
    """A subject on a slope is as near as what is around it."""
    H, W = 33, 47
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(1, 1, 6, 8, generator=generator)
    matte = torch.nn.functional.interpolate(noise, (H, W), mode="bicubic")[0, 0].add(0.5)
    radius = (-8 + 16 * torch.arange(H)[:, None] / H).expand(H, W).float()
    image, matte = torch.rand(3, H, W, generator=generator), matte.clamp(0, 1)
    found = render(image, radius, matte=matte).images[0]
    nudged = render(image, radius * (1 + 1e-7), matte=matte).images[0]
    double = render(image.double(), radius.double(), matte=matte.double()).images[0]
    flipped = render(image.flip(-1), radius.flip(-1), matte=matte.flip(-1)).images[0].flip(-1)
    for other in (nudged, double, flipped):
        assert worst(other.to(found), found) < 2e-5
