"""Laws of the lens, measured on renderings of small pictures.

A law is a function that measures a list of numbers for each of its rows, which name and bound the
worst of them. Discs, symmetries and the gradient are measured in float64, where rounding does not
hide a fault; pictures in float32, as they are rendered for the user. Probes are made in float64 on
the CPU, with the signed CoC radius in px of each of their pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from defocus_core.evaluation.synthetic_scenes import Scenery
from defocus_core.optics.aperture import Aperture
from defocus_core.renderer.layers.quality import find
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


Law = Callable[[LawSetting], list[Check]]
Lists = tuple[list[float], ...]
_RADII = (4.0, 5.3, 7.7, 12.0, 17.0, 23.9, 32.0)  # px, on slice radii and between them
_NEAR = (0.3, 0.5, 0.8, 1.0)  # px
_RIM = 1 / 16  # of the radius: width of a rim at reduced resolution
_MIN_RIM = 7.0  # px of radius; rims of smaller discs have too few pixels

_laws: list[Law] = []


class _Row(NamedTuple):
    """What a `Check` is made of, with the bound of qualities that render coarse pixels of 2 px."""

    law: str
    measured: str
    unit: str
    bound: float
    coarse: float | None = None

    def check(self, off: list[float], coarse: bool) -> Check:
        """The greatest of what was measured: NaN if one is, None if there is none."""
        worst = math.nan if any(map(math.isnan, off)) else max(off, default=None)
        value = 100 * worst if worst is not None and self.unit == "%" else worst
        bound = self.coarse if coarse and self.coarse is not None else self.bound
        return Check(self.law, self.measured, self.unit, value, bound)


def _law(*rows: _Row) -> Callable[[Callable[[LawSetting], Lists]], Law]:
    """Make a law of a function that measures a list for each row."""

    def law_of(measure: Callable[[LawSetting], Lists]) -> Law:
        @wraps(measure)
        def law(setting: LawSetting) -> list[Check]:
            coarse = find(setting.quality).half_size
            lists = zip(rows, measure(setting), strict=True)
            return [row.check(off, coarse) for row, off in lists]

        _laws.append(law)
        return law

    return law_of


def verify(setting: LawSetting | None = None, laws: Sequence[Law] = ()) -> Iterator[list[Check]]:
    """The checks of one law after the other, of all `LAWS` unless some are given."""
    for law in laws or LAWS:
        yield law(setting or LawSetting())


class _Point(NamedTuple):
    """Responses [n, n] to a point of sum 1: a light, or a mark on a surface."""

    r: float
    light: bool
    centre: Tensor
    left: Tensor
    right: Tensor


@lru_cache(maxsize=1)
def _points(setting: LawSetting) -> list[_Point]:
    """Points of all radii."""
    points = []
    for light in (True, False):
        for r in (sign * size for size in _RADII for sign in (1, -1)):
            seen = pictures(spot(r, light=light), setting, torch.float64)
            points.append(_Point(r, light, *(x[0] if light else 1 - x[0] for x in seen)))
    return points


@_law(
    _Row("PSF radius", "slope of second-moment radius over r, off 1", "%", 1.0, 1.5),
    _Row("PSF radius", "second-moment radius off r, |r| 4 to 32 px", "%", 1.0, 10.0),
)
def psf_radius(setting: LawSetting) -> Lists:
    """An isolated point becomes a disc of the radius of its pixel."""
    slopes, off = [], []
    for light in (True, False):
        pairs = [(abs(p.r), disc_radius(p.centre)) for p in _points(setting) if p.light is light]
        slope = sum(r * found for r, found in pairs) / sum(r * r for r, _ in pairs)
        slopes.append(abs(slope - 1))
        off += [abs(found / r - 1) for r, found in pairs]
    return slopes, off


@_law(
    _Row("sharp rim", "disc of a light, from 90 % to 10 %", "px", 1.0, 3.5),
    _Row("sharp rim", "of a surface, beyond a step of slices", "px or r/16", 1.0, 2.0),
)
def sharp_rim(setting: LawSetting) -> Lists:
    """The disc ends within a pixel, that of a surface within a step of slices more."""
    step, lights, surfaces = find(setting.quality), [], []
    for point in _points(setting):
        size = abs(point.r)
        if size < _MIN_RIM:
            continue
        width = rim_width(point.centre, point.r)
        if point.light:
            lights.append(width)
        else:
            beyond = width - max(step.near_spacing, step.far_spacing * size)
            surfaces.append(beyond / max(1.0, _RIM * size))
    return lights, surfaces


@_law(
    _Row("centroid", "of the disc, off the point", "px", 0.01, 2.5),
    _Row("half discs", "distance left to right, off 8 r/(3 pi)", "%", 1.0, 4.0),
    _Row("energy", "sum of an isolated point, off 1", "-", 1e-6, 5e-6),
)
def discs(setting: LawSetting) -> Lists:
    """The disc lies where the point is and has its light; left and right see its halves."""
    places, halves, sums = [], [], []
    for r, _, centre, left, right in _points(setting):
        places.append(math.hypot(*centroid(centre)))
        # pixels show halves 1/(3 pi r) px nearer to each other: the axis cuts a column in two
        apart = (8 * r - 1 / r) / (3 * math.pi)
        distance = centroid(right)[0] - centroid(left)[0]
        halves.append(abs(distance / apart - 1))
        sums.append(abs(float(centre.sum()) - 1))
    return places, halves, sums


@_law(_Row("half discs", "near focus, off 8 r/(3 pi), |r| to 1 px", "px", 0.01, 0.3))
def near_focus(setting: LawSetting) -> Lists:
    """The distance of the half discs follows the formula below 1 px of radius, too."""
    off = []
    for r in (sign * size for size in _NEAR for sign in (1, -1)):
        radius = torch.full(SIZE, r, dtype=torch.float64)
        _, left, right = pictures(Scenery(wave(), radius), setting, torch.float64)
        off.append(abs(shift(right) - shift(left) - 8 * r / (3 * math.pi)))
    return (off,)


@_law(
    *(
        _Row("white stays white", f"white over slope, steps, noise; {name}", "-", 1e-5)
        for name in ("round", "6 blades")
    )
)
def white(setting: LawSetting) -> Lists:
    """A constant picture stays constant over any depth, borders included."""
    scenes = [Scenery(torch.ones(3, *SIZE), radius) for radius in (slope(), strips(), noise())]

    def off(aperture: Aperture) -> list[float]:
        seen = (sides(rendered(scene, setting, aperture=aperture)) for scene in scenes)
        return [worst(picture - 1) for views in seen for picture in views]

    return off(Aperture()), off(Aperture(6, 10.0))


@_law(_Row("left + right", "left + right - 2 centre, of the local maximum", "-", 1e-4))
def left_and_right(setting: LawSetting) -> Lists:
    """Left and right together are twice the centre, occlusions included."""
    off = []
    for scene in scenes():
        centre, left, right = pictures(scene, setting)
        off.append(worst_relative(left + right - 2 * centre, centre))
    return (off,)


@_law(_Row("focus", "picture in focus, change", "-", 1e-6))
def focus(setting: LawSetting) -> Lists:
    """A picture that is all in focus stays as it is."""
    scene = Scenery(waves(), torch.zeros(SIZE))
    seen = pictures(scene, setting)
    return ([worst(picture - scene.image.to(picture)) for picture in seen],)


@_law(
    _Row("nearer covers", "card in focus before blur, change", "-", 1e-5, 0.05),
    _Row("nearer covers", "spill of the card on a plain ground", "-", 1e-5, 1e-3),
)
def occlusion(setting: LawSetting) -> Lists:
    """Nearer covers farther, never the reverse."""

    def off(plain: bool) -> list[float]:
        """Changes of the card, or of the plain ground around it."""
        changes = []
        for background_r in (3.0, 9.0):
            scene = card(0.0, background_r, plain=plain)
            counted = ((scene.signed_radius == 0) != plain).to(setting.device)
            seen = pictures(scene, setting)
            changes += [worst((x - scene.image.to(x))[:, counted]) for x in seen]
        return changes

    return off(plain=False), off(plain=True)


@_law(_Row("tiles", "part of a larger picture, difference", "-", 2e-6))
def tiles(setting: LawSetting) -> Lists:
    """Tiles leave no seam: a picture is the same where it is part of a larger one.

    Pixels with content invented behind edges are left out: it continues all of the visible picture.
    """
    # px; the border is wider than the blur reaches
    whole, size, (top, left), border = (320, 384), (192, 256), (64, 64), 60
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    off = []
    for radius in (slope(whole), strips(whole)):
        large = Scenery(waves(whole), radius)
        part = Scenery(large.image[:, rows, columns], radius[rows, columns])
        one, other = (rendered(scene, setting) for scene in (part, large))
        observed = one.trust > 1 - 1e-5
        for a, b in zip(sides(one), sides(other), strict=True):
            seam = (a - b[:, rows, columns]) * observed
            off.append(worst(seam[:, border:-border, border:-border]))
    return (off,)


@_law(
    _Row("same bytes", "1 and 2 threads, values that differ", "count", 0.0),
    _Row("same bytes", "with and without left, right", "count", 0.0),
)
def same_bytes(setting: LawSetting) -> Lists:
    """Threads, and whether left and right are rendered too, change no byte of the centre."""
    size = (200, 210)  # four tiles
    plane = Scenery(waves(size), slope(size))
    threads, outputs = [], []
    for scene in (plane, card(-7.0, 5.0, size=size)):
        one = rendered(scene, setting, threads=1)
        two = rendered(scene, setting, threads=2)
        alone = rendered(scene, setting, left_right=False)
        pairs = zip(sides(one), sides(two), strict=True)
        threads += [float((a != b).sum()) for a, b in pairs]
        outputs.append(float((one.render != alone.render).sum()))
    return threads, outputs


@_law(
    _Row("rounding", "float32 off float64, of the local maximum", "-", 2e-5),
    _Row("rounding", "last bits of the input, likewise", "-", 2e-5),
)
def rounding(setting: LawSetting) -> Lists:
    """Rounding decides nothing, neither in the renderer nor in its input.

    The renderer compares numbers that are often equal, like depth in levels, to find the surfaces
    beside and behind a pixel. If last bits decided, other devices would render other pictures.
    """
    precision: list[float] = []
    inputs: list[float] = []
    for image, radius in scenes():
        scene = Scenery(image.float(), radius.float())
        changed = Scenery(*map(rounded, scene))
        single = pictures(scene, setting)
        double = pictures(scene, setting, torch.float64)
        for off, others in ((precision, double), (inputs, pictures(changed, setting))):
            off += [worst_relative(a - b, b) for a, b in zip(single, others, strict=True)]
    return precision, inputs


@_law(
    _Row("symmetry", "flips, a mirror swaps left and right", "-", 1e-10),
    _Row("symmetry", "quarter turn of the centre", "-", 1e-10),
)
def symmetry(setting: LawSetting) -> Lists:
    """Flips and quarter turns change nothing; a mirror swaps left and right."""
    flips, turns = [], []
    for scene in scenes():
        centre, left, right = pictures(scene, setting, torch.float64)
        for axis, wanted in ((-1, (centre, right, left)), (-2, (centre, left, right))):
            flipped = Scenery(*(x.flip(axis) for x in scene))
            seen = pictures(flipped, setting, torch.float64)
            flips += [worst(a.flip(axis) - b) for a, b in zip(seen, wanted, strict=True)]
        turned = Scenery(*(x.rot90(1, (-2, -1)) for x in scene))
        seen_turned = rendered(turned, setting, torch.float64, left_right=False).render
        turns.append(worst(seen_turned.rot90(-1, (-2, -1)) - centre))
    return flips, turns


@_law(_Row("gradient", "slope off a finite difference", "-", 1e-5, 3e-3))
def gradient(setting: LawSetting) -> Lists:
    """The gradient to image and radius is that of finite differences, along one direction."""
    size, generator = (9, 11), torch.Generator().manual_seed(0)
    radius = slope(size) / 4 + 0.013  # off the slice radii, where slopes change
    radius[3:6, 4:8] -= 3.1  # a nearer card

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(setting.device)

    weight, directions = random(3, *size), (random(3, *size), random(*size))
    at = [x.to(setting.device).requires_grad_() for x in (waves(size), radius)]

    def weighted_sum(step: float) -> Tensor:
        moved = Scenery(*(x + step * d for x, d in zip(at, directions, strict=True)))
        rendering = rendered(moved, setting, torch.float64, left_right=False)
        return (rendering.render * weight).sum()

    slopes = torch.autograd.grad(weighted_sum(0.0), at, materialize_grads=True)
    exact = sum(float((s * d).sum()) for s, d in zip(slopes, directions, strict=True))
    step = 1e-6
    with torch.no_grad():
        finite = float(weighted_sum(step) - weighted_sum(-step)) / (2 * step)
    return ([abs(exact - finite) / max(abs(finite), 1e-12)],)


@_law(_Row("CPU and GPU", "difference, of the local maximum", "-", 1e-4))
def devices(setting: LawSetting) -> Lists:
    """The CPU and the GPU render the same picture; without a GPU there is nothing to compare."""
    off: list[float] = []
    for scene in scenes() if setting.device != "cpu" else []:
        there, here = (pictures(scene, s) for s in (setting, replace(setting, device="cpu")))
        off += [worst_relative(a.cpu() - b, b) for a, b in zip(there, here, strict=True)]
    return (off,)


LAWS = tuple(_laws)
