"""The laws of ``defocus verify`` hold, and each of them fails on a renderer with its fault."""

import math
from dataclasses import replace
from itertools import count

import pytest
import torch
from torch.nn.functional import avg_pool2d

from defocus_core import render as true_render
from defocus_core.evaluation.lens_laws import LAWS, LawSetting, verify

GPU_ALIKE = LawSetting("cpu:0")  # not "cpu": compared with it as a GPU is


def on_pictures(change):
    """A renderer that does something to each of its pictures."""

    def wrong(image, radius, **options):
        seen = true_render(image, radius, **options)
        return seen._replace(images=[change(image) for image in seen.images])

    return wrong


def on_radii(change):
    """A renderer that takes radii for others."""
    return lambda image, radius, **options: true_render(image, change(radius), **options)


def on_pair(change):
    def wrong(image, radius, **options):
        seen = true_render(image, radius, **options)
        left, right = change(seen.left, seen.right)
        return seen._replace(images=[seen.render, left, right])

    return wrong


def brighter_each_time():
    calls = count()
    return on_pictures(lambda picture: picture * (1 + 1e-3 * next(calls)))


def vignette(picture):
    """Darker to the right and below, as if places in the frame mattered."""
    H, W = picture.shape[-2:]
    down, across = torch.linspace(1, 0.999, H)[:, None], torch.linspace(1, 0.999, W)
    return picture * (down * across).to(picture)


def soft(picture):
    return avg_pool2d(picture, 9, stride=1, padding=4, count_include_pad=False)


FAULTS = {
    "blurred too wide": (on_radii(lambda r: 1.03 * r), {"disc"}),
    "blurred too wide where it is wide": (
        on_radii(lambda r: r * (1.02 if float(r.detach().max()) > 20 else 1)),
        {"disc"},
    ),
    "a soft lens": (on_pictures(soft), {"disc", "focus"}),
    "energy lost": (on_pictures(lambda x: 0.999 * x), {"white", "focus"}),
    "one half darker": (on_pair(lambda left, right: (0.999 * left, right)), {"left + right"}),
    "farther covers": (on_radii(torch.neg), {"nearer covers"}),
    "places matter": (on_pictures(vignette), {"tiles"}),
    "a wrong slope": (on_radii(lambda r: 2 * r - r.detach()), {"gradient"}),
    "machines matter": (brighter_each_time(), {"CPU and GPU"}),
    "not a number": (on_pictures(lambda x: x * math.nan), {law.name for law in LAWS}),
}


@pytest.mark.parametrize(
    "quality",
    ["standard", *(pytest.param(q, marks=pytest.mark.bench) for q in ("high", "reference"))],
)
def test_the_renderer_keeps_all_laws(quality):
    *checks, devices = verify(replace(GPU_ALIKE, quality=quality))
    assert [check for check in (*checks, devices) if not check.ok] == []
    assert devices.value is not None


def test_without_a_gpu_there_are_no_devices_to_compare():
    (law,) = (law for law in LAWS if law.name == "CPU and GPU")
    assert law.numbers(LawSetting()) == []


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_fails_its_laws(fault, monkeypatch):
    wrong, named = FAULTS[fault]
    laws = tuple(law for law in LAWS if law.name in named)
    monkeypatch.setattr("defocus_core.evaluation.lens_laws.LAWS", laws)
    checks = [*verify(replace(GPU_ALIKE, render=wrong))]
    assert len(checks) == len(named)
    assert not [check for check in checks if check.ok]


def test_every_law_can_fail():
    assert set().union(*(named for _, named in [*FAULTS.values()][:-1])) == {x.name for x in LAWS}
