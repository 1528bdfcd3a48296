"""Eight laws of the lens, measured on renderings of small pictures.

A law is a row of `LAWS`: a function that measures numbers, and the bound that the greatest of them
must keep. Discs and the gradient are measured in float64, where rounding does not hide a fault;
pictures in float32, as they are rendered for the user. Test scenes are made in float64 on the CPU;
each is a picture and the signed CoC radius in px of each of its pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.optics.aperture import Aperture
from defocus_core.renderer.render import render
from defocus_core.tensors.views import ViewTensors

Scene = tuple[Tensor, Tensor]  # image [C, H, W] and signed radius [H, W] px
SIZE = (72, 210)  # H, W: not square, more than one tile
_RADII = (4.0, 5.3, 7.7, 12.0, 17.0, 23.9, 32.0)  # px, equal to slice radii and between them


@dataclass(frozen=True)
class LawSetting:
    """How the scenes of the laws are rendered."""

    device: str = "cpu"  # torch's name of the device
    quality: str = "standard"  # as for `render`
    threads: int = 1  # as for `render`
    render: Callable[..., ViewTensors] = render  # the renderer

    def views(
        self, scene: Scene, dtype: torch.dtype = torch.float32, **options: Any
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """(centre, left, right, trust) of a scene; `options` are further options of `render`."""
        image, radius = (x.to(self.device, dtype).contiguous() for x in scene)
        asked = {"quality": self.quality, "threads": self.threads, "left_right": True} | options
        views = self.render(image, radius, **asked)
        centre, left, right = views.images
        return centre, left, right, views.trust


@dataclass(frozen=True)
class Check:
    """The greatest number that was measured for a law, with the bound of the law."""

    law: str  # name of the law
    measured: str  # the measurement, in words
    unit: str  # of the value and the bound
    value: float | None  # the greatest measured value; None if it needs a GPU and there is none
    bound: float  # the largest value that the law allows

    @property
    def ok(self) -> bool:
        """Whether the law holds. A value that was not measured passes, NaN fails."""
        return self.value is None or self.value <= self.bound


class Law(NamedTuple):
    """A law: its name, the function that measures it, and the bound."""

    name: str
    measured: str  # the measurement, in words
    unit: str  # of the numbers and the bound
    bound: float  # the greatest number that the law allows
    numbers: Callable[[LawSetting], list[float]]  # measures


def verify(setting: LawSetting | None = None) -> Iterator[Check]:
    """Yield the check of each law in `LAWS`, as soon as it is measured."""
    for name, measured, unit, bound, numbers in LAWS:
        found = numbers(setting or LawSetting())
        worst = math.nan if any(map(math.isnan, found)) else max(found, default=None)
        yield Check(name, measured, unit, worst, bound)


def waves(size: tuple[int, int] = SIZE) -> Tensor:
    """A picture [3, H, W] of smooth coloured waves in [0.1, 0.9]."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in size)
    phases = [(1.0, 0.3), (-0.4, 1.0), (0.7, 0.7)]
    turns = [(a * x + b * y[:, None]) / 11 for a, b in phases]
    return 0.5 + 0.4 * torch.sin(2 * math.pi * torch.stack(turns))


def slope(size: tuple[int, int] = SIZE) -> Tensor:
    """Radii [H, W] px of a plane through the focus that recedes to the right and upwards."""
    across = torch.linspace(0, 1, size[1], dtype=torch.float64)
    upward = torch.linspace(1, 0, size[0], dtype=torch.float64)[:, None]
    return -6.0 + 15.0 * (0.8 * across + 0.2 * upward)


def strips(size: tuple[int, int] = SIZE) -> Tensor:
    """Radii [H, W] px of four upright strips in a mixed order of depth."""
    values = torch.tensor([4.0, -5.0, 0.0, 8.0], dtype=torch.float64)
    return values[torch.arange(size[1]) * 4 // size[1]].expand(size).clone()


def card(card_r: float, background_r: float, *, plain: bool = False) -> Scene:
    """A scene with a card before waves, or before a uniform dark ground if `plain`.

    `card_r`, `background_r`: signed radii in px.
    """
    H, W = SIZE
    on_card = torch.zeros(SIZE, dtype=torch.bool)
    on_card[H // 4 : 2 * H // 3, W // 3 : 3 * W // 5] = True
    tint = torch.tensor([0.95, 0.75, 0.3], dtype=torch.float64)[:, None, None]
    background = torch.full((3, H, W), 0.3, dtype=torch.float64) if plain else 0.6 * waves()
    radius = torch.where(on_card, card_r, background_r).to(torch.float64)
    return torch.where(on_card, tint, background), radius


def scenes() -> list[Scene]:
    """Four scenes: a slope through the focus, strips, and cards at several depths."""
    cards = card(-7.0, 0.0), card(0.0, 7.0), card(-5.0, 6.0)
    return [(waves(), slope()), (waves(), strips()), *cards]


def _worst(difference: Tensor) -> float:
    return float(difference.detach().abs().max())


def _worst_relative(difference: Tensor, picture: Tensor) -> float:
    """The greatest absolute difference, relative to the picture's greatest value within 4 px."""
    around = max_pool2d(picture.abs(), 9, stride=1, padding=4)
    return _worst(difference / around.clamp(min=1e-12))


def white(setting: LawSetting) -> list[float]:
    """The changes of a white picture over any depth, borders included."""
    noise = 18 * torch.rand(SIZE, generator=torch.Generator().manual_seed(0)) - 9
    return [
        _worst(picture - 1)
        for radius in (slope(), strips(), noise)
        for aperture in (Aperture(), Aperture(6, 10.0))
        for picture in setting.views((torch.ones(3, *SIZE), radius), aperture=aperture)[:3]
    ]


def disc(setting: LawSetting) -> list[float]:
    """The % by which discs of points are too large or too small, and % of light beyond their rims.

    Each radius is measured twice, as a light on black is drawn by its own kernel, but a dark spot
    on white goes through slices. The radius follows from the second moment, r²/4 on each axis, to
    which the area of a pixel adds 1/12 px².
    """
    found = []
    for r in (sign * size for size in _RADII for sign in (1, -1)):
        n = 2 * math.ceil(2.4 * abs(r)) + 9  # the slice radius above r is 20 % wider at most
        light, radius = torch.zeros(1, n, n), torch.full((n, n), r)
        light[:, n // 2, n // 2] = 1.0
        drawn = setting.views((light, radius), torch.float64)[0][0]
        sliced = 1 - setting.views((1 - light, radius), torch.float64)[0][0]
        at = torch.arange(n, dtype=drawn.dtype, device=drawn.device) - n // 2
        square = at.square() + at.square()[:, None]
        for response in (drawn, sliced):
            moment = float((response * square).sum() / response.sum()) / 2
            found.append(100 * abs(2 * math.sqrt(max(moment - 1 / 12, 0.0)) / abs(r) - 1))
        found.append(100 * _worst(drawn[square.sqrt() > abs(r) + 1].sum()))
    return found


def focus(setting: LawSetting) -> list[float]:
    """The changes of a picture that is entirely in focus."""
    image = waves()
    seen = setting.views((image, torch.zeros(SIZE)))[:3]
    return [_worst(picture - image.to(picture)) for picture in seen]


def occlusion(setting: LawSetting) -> list[float]:
    """The changes of a card in focus before blurred waves, and of uniform ground around a card."""
    changes = []
    for plain in (False, True):
        for background_r in (3.0, 9.0):
            image, radius = card(0.0, background_r, plain=plain)
            counted = ((radius == 0) != plain).to(setting.device)
            seen = setting.views((image, radius))[:3]
            changes += [_worst((x - image.to(x))[:, counted]) for x in seen]
    return changes


def left_and_right(setting: LawSetting) -> list[float]:
    """The differences of left plus right from twice the centre, relative to values within 4 px."""
    seen = (setting.views(scene)[:3] for scene in scenes())
    return [_worst_relative(left + right - 2 * centre, centre) for centre, left, right in seen]


def tiles(setting: LawSetting) -> list[float]:
    """The differences between a picture and the same picture rendered as a part of a larger one.

    Pixels with invented content are left out, since that depends on all of the visible picture.
    """
    # px; the border is wider than the blur reaches
    whole, rows, columns, border = (320, 384), slice(64, 256), slice(64, 320), 60
    off = []
    for radius in (slope(whole), strips(whole)):
        image = waves(whole)
        one = setting.views((image[:, rows, columns], radius[rows, columns]))
        other = setting.views((image, radius))
        observed = one[3] > 1 - 1e-5
        for a, b in zip(one[:3], other[:3], strict=True):
            seam = (a - b[:, rows, columns]) * observed
            off.append(_worst(seam[:, border:-border, border:-border]))
    return off


def gradient(setting: LawSetting) -> list[float]:
    """The relative error of the gradient by image and radius, compared with a finite difference."""
    size, generator = (9, 11), torch.Generator().manual_seed(0)
    radius = slope(size) / 4 + 0.013  # away from slice radii, where slopes change
    radius[3:6, 4:8] -= 3.1  # a nearer card

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(setting.device)

    weight, directions = random(3, *size), (random(3, *size), random(*size))
    at = [x.to(setting.device).requires_grad_() for x in (waves(size), radius)]

    def weighted_sum(step: float) -> Tensor:
        image, radius = (x + step * d for x, d in zip(at, directions, strict=True))
        return (setting.views((image, radius), torch.float64)[0] * weight).sum()

    slopes = torch.autograd.grad(weighted_sum(0.0), at, materialize_grads=True)
    exact = sum(float((s * d).sum()) for s, d in zip(slopes, directions, strict=True))
    step = 1e-6
    with torch.no_grad():
        finite = float(weighted_sum(step) - weighted_sum(-step)) / (2 * step)
    return [abs(exact - finite) / max(abs(finite), 1e-12)]


def devices(setting: LawSetting) -> list[float]:
    """The differences between renderings on the CPU and on the GPU, relative to values within 4 px.

    There are none without a GPU.
    """
    off: list[float] = []
    for scene in scenes() if setting.device != "cpu" else []:
        there, here = (s.views(scene)[:3] for s in (setting, replace(setting, device="cpu")))
        off += [_worst_relative(a.cpu() - b, b) for a, b in zip(there, here, strict=True)]
    return off


LAWS = (
    Law("white", "change of white over a slope, steps and noise", "-", 1e-5, white),
    Law("disc", "radius off that of the pixel, and light beyond the rim", "%", 1.0, disc),
    Law("focus", "change of a picture in focus", "-", 1e-6, focus),
    Law("nearer covers", "change of a card in focus and the ground around", "-", 1e-5, occlusion),
    Law("left + right", "off twice the centre, of the local maximum", "-", 1e-4, left_and_right),
    Law("tiles", "difference from a part of a larger picture", "-", 3e-5, tiles),
    Law("gradient", "slope off a finite difference", "-", 1e-5, gradient),
    Law("CPU and GPU", "difference, of the local maximum", "-", 1e-4, devices),
)
