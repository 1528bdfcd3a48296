"""Probes of laws: small pictures, numbers measured on their renderings, and checks of these.

Pictures are float64 on the CPU, with the signed CoC radius in px of each of their pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.evaluation.synthetic_scenes import Scenery
from defocus_core.renderer.render import render
from defocus_core.tensors.views import Views

SIZE = (72, 210)  # H, W: not square, more than one tile
# Wavelength in px.
PERIOD = 16
# Distance in px between samples of the profile of a rim.
_STEP = 0.25


def spot(r: float, *, light: bool) -> Scenery:
    """One odd pixel in the middle of a frame that is wider than its blur.

    A light is 1 on black, and drawn by its own kernel. Otherwise the pixel is black on white, a
    mark on a surface, which goes through slices.
    """
    n = 2 * math.ceil(2.4 * abs(r)) + 9  # the slice radius above r is 20 % wider at most
    image = torch.full((1, n, n), 0.0 if light else 1.0, dtype=torch.float64)
    image[:, n // 2, n // 2] = 1.0 if light else 0.0
    return Scenery(image, torch.full((n, n), r, dtype=torch.float64))


def waves(size: tuple[int, int] = SIZE) -> Tensor:
    """Smooth coloured waves in [0.1, 0.9]: [3, H, W]."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in size)
    phases = [(1.0, 0.3), (-0.4, 1.0), (0.7, 0.7)]
    turns = [(a * x + b * y[:, None]) / 11 for a, b in phases]
    return 0.5 + 0.4 * torch.sin(2 * math.pi * torch.stack(turns))


def wave(size: tuple[int, int] = SIZE) -> Tensor:
    """A grey wave along x in [0.5, 1.5], with a crest at the first column: [1, H, W]."""
    x = torch.arange(size[1], dtype=torch.float64)
    return (1 + 0.5 * torch.cos(2 * math.pi * x / PERIOD)).expand(1, *size).clone()


def slope(size: tuple[int, int] = SIZE) -> Tensor:
    """Radius of a plane through the focus that recedes to the right and upwards: [H, W] px."""
    across = torch.linspace(0, 1, size[1], dtype=torch.float64)
    upward = torch.linspace(1, 0, size[0], dtype=torch.float64)[:, None]
    return -6.0 + 15.0 * (0.8 * across + 0.2 * upward)


def strips(size: tuple[int, int] = SIZE) -> Tensor:
    """Radius of four upright strips in a mixed order of depth: [H, W] px."""
    values = torch.tensor([4.0, -5.0, 0.0, 8.0], dtype=torch.float64)
    return values[torch.arange(size[1]) * 4 // size[1]].expand(size).clone()


def levels(size: tuple[int, int] = SIZE) -> Tensor:
    """Radii of two dozen cards over each other, from -8 to 8 px in steps of 1.6: [H, W]."""
    generator = torch.Generator().manual_seed(2)

    def random(below: int, count: int = 1) -> list[int]:
        return torch.randint(below, (count,), generator=generator).tolist()

    radius = torch.full(size, 8.0, dtype=torch.float64)
    for level in random(11, 24):
        (top,), (left,), (height, width) = random(size[0]), random(size[1]), random(50, 2)
        radius[top : top + height + 1, left : left + width + 1] = 1.6 * level - 8
    return radius


def noise(size: tuple[int, int] = SIZE) -> Tensor:
    """Independent radii from -9 to 9 px: [H, W]."""
    generator = torch.Generator().manual_seed(0)
    return 18.0 * torch.rand(size, generator=generator, dtype=torch.float64) - 9.0


def card(
    card_r: float, background_r: float, *, plain: bool = False, size: tuple[int, int] = SIZE
) -> Scenery:
    """A card before waves, or before one dark colour."""
    H, W = size
    on_card = torch.zeros(size, dtype=torch.bool)
    on_card[H // 4 : 2 * H // 3, W // 3 : 3 * W // 5] = True
    tint = torch.tensor([0.95, 0.75, 0.3], dtype=torch.float64)[:, None, None]
    background = torch.full((3, H, W), 0.3, dtype=torch.float64) if plain else 0.6 * waves(size)
    radius = torch.where(on_card, card_r, background_r).to(torch.float64)
    return Scenery(torch.where(on_card, tint, background), radius)


def scenes() -> list[Scenery]:
    """A slope through focus, cards before and behind it, and cards in equal steps of radius."""
    return [
        Scenery(waves(), slope()),
        Scenery(waves(), levels()),
        card(-7.0, 0.0),
        card(0.0, 7.0),
        card(-5.0, 6.0),
    ]


def rounded(values: Tensor) -> Tensor:
    """Values with the last bit changed, up or down at random; equal values stay equal."""
    different, number = torch.unique(values, return_inverse=True)
    ways = torch.randint(2, different.shape, generator=torch.Generator().manual_seed(0)) * 2 - 1
    return torch.nextafter(different, ways * torch.full_like(different, torch.inf))[number]


def worst(difference: Tensor) -> float:
    """Greatest absolute value."""
    return float(difference.detach().abs().max())


def worst_relative(difference: Tensor, picture: Tensor) -> float:
    """Greatest absolute value, as a share of the greatest of the picture within 4 px."""
    around = max_pool2d(picture.abs(), 9, stride=1, padding=4)
    return worst(difference / around.clamp(min=1e-12))


def centroid(response: Tensor) -> tuple[float, float]:
    """Column and row of the centre of mass of a response [n, n], in px from the middle pixel."""
    fraction, at = response / response.sum(), _centred(response)
    return float((fraction.sum(0) * at).sum()), float((fraction.sum(1) * at).sum())


def shift(picture: Tensor) -> float:
    """Px by which a wave [1, H, W] stands to the right, within half of its length."""
    rows = picture[0, picture.shape[1] // 2, PERIOD:-PERIOD]
    rows = rows[: len(rows) // PERIOD * PERIOD]  # whole waves
    x = torch.arange(len(rows), dtype=rows.dtype, device=rows.device)
    angle = 2 * math.pi * x / PERIOD
    phase = math.atan2(float(rows @ angle.sin()), float(rows @ angle.cos()))
    return phase * PERIOD / (2 * math.pi)


def disc_radius(response: Tensor) -> float:
    """Radius in px of the disc with the second moment of a response [n, n].

    A disc has r²/4 on each axis, the integration over a pixel adds 1/12 px².
    """
    fraction, square = response / response.sum(), _centred(response).square()
    moment = float((fraction.sum(0) * square).sum() + (fraction.sum(1) * square).sum()) / 2
    return 2 * math.sqrt(max(moment - 1 / 12, 0.0))


def rim_width(response: Tensor, r: float) -> float:
    """Px over which the disc of a response [n, n] falls from 90 % to 10 % of its plateau.

    All pixels are sorted by their distance from the middle, as along a slanted edge; infinity if
    there is no such fall.
    """
    at = _centred(response)
    distance = torch.hypot(at, at[:, None])
    plateau = response[distance < 0.5 * abs(r)].mean()
    ring = distance > 0.6 * abs(r)
    index = (distance[ring] / _STEP).long()
    zeros = response.new_zeros(int(index.max()) + 1)
    count = zeros.index_add(0, index, torch.ones_like(distance[ring]))
    mean = [zeros.index_add(0, index, x[ring])[count > 0] for x in (distance, response / plateau)]
    position, height = (x / count[count > 0] for x in mean)
    return _falls_to(0.1, position, height) - _falls_to(0.9, position, height)


def _falls_to(level: float, position: Tensor, height: Tensor) -> float:
    """Where a falling profile first reaches a level."""
    below = torch.nonzero(height < level)
    if not len(below) or int(below[0]) == 0:
        return math.inf if level < 0.5 else -math.inf
    k = int(below[0])
    fraction = (height[k - 1] - level) / (height[k - 1] - height[k])
    return float(position[k - 1] + fraction * (position[k] - position[k - 1]))


def _centred(response: Tensor) -> Tensor:
    """Coordinates of pixels from the middle one."""
    n = response.shape[-1]
    return torch.arange(n, dtype=response.dtype, device=response.device) - n // 2


@dataclass(frozen=True)
class LawSetting:
    """The setting that probes are rendered in."""

    device: str = "cpu"  # where to compute, as torch calls it
    quality: str = "standard"  # as for `render`
    threads: int = 1  # as for `render`
    render: Callable[..., Views] = render  # the renderer


@dataclass(frozen=True)
class Check:
    """One number that a law bounds."""

    law: str  # its name
    measured: str  # the measurement, in words
    unit: str  # of the value and the bound
    value: float | None  # the worst that was measured; None if there was nothing to measure it on
    bound: float  # the largest value that the law allows

    @property
    def ok(self) -> bool:
        """Whether the law holds: a value that was not measured does not break it, NaN does."""
        return self.value is None or self.value <= self.bound


def rendered(
    scene: Scenery, setting: LawSetting, dtype: torch.dtype = torch.float32, **options: Any
) -> Views:
    """The rendering of a scene, with other options of the renderer than those of the setting."""
    image, radius = (x.to(setting.device, dtype).contiguous() for x in scene)
    asked = {"quality": setting.quality, "threads": setting.threads, "left_right": True}
    return setting.render(image, radius, **asked | options)


def sides(views: Views) -> tuple[Tensor, Tensor, Tensor]:
    """Centre, left and right."""
    assert views.left is not None
    assert views.right is not None
    return views.render, views.left, views.right


def pictures(
    scene: Scenery, setting: LawSetting, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor, Tensor]:
    """Centre, left and right of a scene."""
    return sides(rendered(scene, setting, dtype))
