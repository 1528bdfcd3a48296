"""Laws of the lens, measured on renderings of small pictures.

Each law is a function of a `LawSetting` that returns `Check`s: numbers with their bounds. Discs,
symmetries and the gradient are measured in float64, where rounding does not hide a fault; pictures
in float32, as they are rendered for the user.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from defocus_core.evaluation import law_probes as probes
from defocus_core.evaluation.law_probes import (
    Check,
    LawSetting,
    greatest,
    pictures,
    rendered,
)
from defocus_core.evaluation.synthetic_scenes import Scenery
from defocus_core.optics.aperture import Aperture
from defocus_core.renderer.layers.quality import find

Law = Callable[[LawSetting], list[Check]]
# Wider bounds of checks at qualities that render in coarse pixels of 2 px.
_IN_COARSE_PIXELS = {
    "slope of second-moment radius over r, off 1": 1.5,
    "second-moment radius off r, |r| 4 to 32 px": 10.0,
    "disc of a light, from 90 % to 10 %": 3.5,
    "of a surface, beyond a step of slices": 2.0,
    "of the disc, off the point": 2.5,
    "distance left to right, off 8 r/(3 pi)": 4.0,
    "near focus, off 8 r/(3 pi), |r| to 1 px": 0.3,
    "card in focus before blur, change": 0.05,
    "spill of the card on a plain ground": 1e-3,
    "sum of an isolated point, off 1": 5e-6,
    "slope off a finite difference": 3e-3,
}
_RADII = (4.0, 5.3, 7.7, 12.0, 17.0, 23.9, 32.0)  # px, on slice radii and between them
_NEAR = (0.3, 0.5, 0.8, 1.0)  # px
_RIM = 1 / 16  # of the radius: width of a rim at reduced resolution
_MIN_RIM = 7.0  # px of radius; rims of smaller discs have too few pixels


def verify(setting: LawSetting | None = None, laws: Sequence[Law] = ()) -> Iterator[list[Check]]:
    """The checks of one law after the other, of all `LAWS` unless some are given."""
    setting = setting or LawSetting()
    in_coarse_pixels = find(setting.quality).half_size
    for law in laws or LAWS:
        checks = law(setting)
        if in_coarse_pixels:
            checks = [replace(c, bound=_IN_COARSE_PIXELS.get(c.measured, c.bound)) for c in checks]
        yield checks


def discs(setting: LawSetting) -> list[Check]:
    """An isolated point becomes a disc: its radius, rim, place, halves and energy."""
    step = find(setting.quality)
    relative: list[float] = []
    slopes, centres, halves, sums = [], [], [], []
    rims: dict[bool, list[float]] = {True: [], False: []}
    for light in (True, False):
        lengths = []
        for r in (sign * size for size in _RADII for sign in (1, -1)):
            whole, left, right = _responses(r, light, setting)
            lengths.append((abs(r), probes.disc_radius(whole)))
            centres.append(math.hypot(*probes.centroid(whole)))
            sums.append(abs(float(whole.sum()) - 1))
            # pixels show halves 1/(3 pi r) px nearer to each other: the axis cuts a column in two
            apart = (8 * r - 1 / r) / (3 * math.pi)
            distance = probes.centroid(right)[0] - probes.centroid(left)[0]
            halves.append(abs(distance / apart - 1))
            if abs(r) >= _MIN_RIM:
                radii = 0.0 if light else max(step.near_spacing, step.far_spacing * abs(r))
                minimum = 1.0 if light else max(1.0, _RIM * abs(r))
                rims[light].append((probes.rim_width(whole, r) - radii) / minimum)
        fit = sum(r * measured for r, measured in lengths) / sum(r * r for r, _ in lengths)
        slopes.append(abs(fit - 1))
        relative += [abs(measured / r - 1) for r, measured in lengths]
    return [
        Check("PSF radius", "slope of second-moment radius over r, off 1", "%", _pc(slopes), 1.0),
        Check("PSF radius", "second-moment radius off r, |r| 4 to 32 px", "%", _pc(relative), 1.0),
        Check("sharp rim", "disc of a light, from 90 % to 10 %", "px", greatest(rims[True]), 1.0),
        Check(
            "sharp rim",
            "of a surface, beyond a step of slices",
            "px or r/16",
            greatest(rims[False]),
            1.0,
        ),
        Check("centroid", "of the disc, off the point", "px", greatest(centres), 0.01),
        Check("half discs", "distance left to right, off 8 r/(3 pi)", "%", _pc(halves), 1.0),
        Check("energy", "sum of an isolated point, off 1", "-", greatest(sums), 1e-6),
    ]


def near_focus(setting: LawSetting) -> list[Check]:
    """The distance of the half discs follows the formula below 1 px of radius, too."""
    off = []
    for r in (sign * size for size in _NEAR for sign in (1, -1)):
        radius = torch.full(probes.SIZE, r, dtype=torch.float64)
        _, left, right = pictures(rendered(Scenery(probes.wave(), radius), setting, torch.float64))
        off.append(abs(probes.shift(right) - probes.shift(left) - 8 * r / (3 * math.pi)))
    measured = "near focus, off 8 r/(3 pi), |r| to 1 px"
    return [Check("half discs", measured, "px", greatest(off), 0.01)]


def white(setting: LawSetting) -> list[Check]:
    """A constant picture stays constant over any depth, borders included."""
    checks = []
    for name, aperture in (("round", Aperture()), ("6 blades", Aperture(6, 10.0))):
        off = []
        for radius in (probes.slope(), probes.strips(), probes.noise()):
            scene = Scenery(torch.ones(3, *probes.SIZE), radius)
            views = rendered(scene, setting, torch.float32, aperture=aperture)
            off += [probes.worst(picture - 1) for picture in pictures(views)]
        measured = f"white over slope, steps, noise; {name}"
        checks.append(Check("white stays white", measured, "-", greatest(off), 1e-5))
    return checks


def left_and_right(setting: LawSetting) -> list[Check]:
    """Left and right together are twice the centre, occlusions included."""
    off = []
    for scene in probes.scenes():
        centre, left, right = pictures(rendered(scene, setting, torch.float32))
        off.append(probes.worst_relative(left + right - 2 * centre, centre))
    measured = "left + right - 2 centre, of the local maximum"
    return [Check("left + right", measured, "-", greatest(off), 1e-4)]


def focus(setting: LawSetting) -> list[Check]:
    """A picture that is all in focus stays as it is."""
    scene = Scenery(probes.waves(), torch.zeros(probes.SIZE))
    views = rendered(scene, setting, torch.float32)
    off = [probes.worst(picture - scene.image.to(picture)) for picture in pictures(views)]
    return [Check("focus", "picture in focus, change", "-", greatest(off), 1e-6)]


def occlusion(setting: LawSetting) -> list[Check]:
    """Nearer covers farther, never the reverse."""
    covered, spilt = [], []
    for background_r in (3.0, 9.0):
        scene = probes.card(0.0, background_r)
        on_card = (scene.signed_radius == 0).to(setting.device)
        for picture in pictures(rendered(scene, setting, torch.float32)):
            covered.append(probes.worst((picture - scene.image.to(picture))[:, on_card]))
        plain = probes.card(0.0, background_r, plain=True)
        for picture in pictures(rendered(plain, setting, torch.float32)):
            spilt.append(probes.worst((picture - plain.image.to(picture))[:, ~on_card]))
    law = "nearer covers"
    return [
        Check(law, "card in focus before blur, change", "-", greatest(covered), 1e-5),
        Check(law, "spill of the card on a plain ground", "-", greatest(spilt), 1e-5),
    ]


def symmetry(setting: LawSetting) -> list[Check]:
    """Flips and quarter turns change nothing; a mirror swaps left and right."""
    flips, turns = [], []
    for image, radius in probes.scenes():
        centre, left, right = pictures(rendered(Scenery(image, radius), setting, torch.float64))
        mirrored = Scenery(image.flip(-1), radius.flip(-1))
        upset = Scenery(image.flip(-2), radius.flip(-2))
        turned = Scenery(image.rot90(1, (-2, -1)), radius.rot90())
        for scene, axis, expected in (
            (mirrored, -1, (centre, right, left)),
            (upset, -2, (centre, left, right)),
        ):
            flipped = pictures(rendered(scene, setting, torch.float64))
            flips += [
                probes.worst(a.flip(axis) - b) for a, b in zip(flipped, expected, strict=True)
            ]
        turned_centre = rendered(turned, setting, torch.float64, left_right=False).render
        turns.append(probes.worst(turned_centre.rot90(-1, (-2, -1)) - centre))
    return [
        Check("symmetry", "flips, a mirror swaps left and right", "-", greatest(flips), 1e-10),
        Check("symmetry", "quarter turn of the centre", "-", greatest(turns), 1e-10),
    ]


def gradient(setting: LawSetting) -> list[Check]:
    """The gradient to image and radius is that of finite differences, along one direction."""
    size, generator = (9, 11), torch.Generator().manual_seed(0)
    radius = probes.slope(size) / 4 + 0.013  # off the slice radii, where slopes change
    radius[3:6, 4:8] -= 3.1  # a nearer card

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(setting.device)

    weight, directions = random(3, *size), (random(3, *size), random(*size))
    at = [x.to(setting.device).requires_grad_() for x in (probes.waves(size), radius)]

    def weighted_sum(step: float) -> Tensor:
        moved = [x + step * d for x, d in zip(at, directions, strict=True)]
        scene = Scenery(moved[0], moved[1])
        rendering = rendered(scene, setting, torch.float64, left_right=False)
        return (rendering.render * weight).sum()

    slopes = torch.autograd.grad(weighted_sum(0.0), at, materialize_grads=True)
    exact = sum(float((s * d).sum()) for s, d in zip(slopes, directions, strict=True))
    step = 1e-6
    with torch.no_grad():
        finite = float(weighted_sum(step) - weighted_sum(-step)) / (2 * step)
    off = abs(exact - finite) / max(abs(finite), 1e-12)
    return [Check("gradient", "slope off a finite difference", "-", off, 1e-5)]


def _responses(r: float, light: bool, setting: LawSetting) -> tuple[Tensor, ...]:
    """Responses [n, n] to a point of sum 1, in centre, left and right."""
    views = rendered(probes.spot(r, light=light), setting, torch.float64)
    return tuple(picture[0] if light else 1 - picture[0] for picture in pictures(views))


def _pc(fractions: list[float]) -> float:
    return 100 * greatest(fractions)


def tiles(setting: LawSetting) -> list[Check]:
    """Tiles leave no seam: a picture is the same where it is part of a larger one.

    Pixels with content invented behind edges are left out: it continues all of the visible picture.
    """
    # px; the border is wider than the blur reaches
    whole, size, (top, left), border = (320, 384), (192, 256), (64, 64), 60
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    off = []
    for radius in (probes.slope(whole), probes.strips(whole)):
        large = Scenery(probes.waves(whole), radius)
        part = Scenery(large.image[:, rows, columns], radius[rows, columns])
        one, other = (rendered(scene, setting, torch.float32) for scene in (part, large))
        observed = one.trust > 1 - 1e-5
        for a, b in zip(pictures(one), pictures(other), strict=True):
            seam = (a - b[:, rows, columns]) * observed
            off.append(probes.worst(seam[:, border:-border, border:-border]))
    return [Check("tiles", "part of a larger picture, difference", "-", greatest(off), 2e-6)]


def same_bytes(setting: LawSetting) -> list[Check]:
    """Threads, and whether left and right are rendered too, change no byte of the centre."""
    size = (200, 210)  # four tiles
    threads, outputs = 0.0, 0.0
    for scene in (
        Scenery(probes.waves(size), probes.slope(size)),
        probes.card(-7.0, 5.0, size=size),
    ):
        one = rendered(scene, setting, torch.float32, threads=1)
        two = rendered(scene, setting, torch.float32, threads=2)
        alone = rendered(scene, setting, torch.float32, left_right=False)
        for a, b in zip(pictures(one), pictures(two), strict=True):
            threads += float((a != b).sum())
        outputs += float((one.render != alone.render).sum())
    return [
        Check("same bytes", "1 and 2 threads, values that differ", "count", threads, 0.0),
        Check("same bytes", "with and without left, right", "count", outputs, 0.0),
    ]


def rounding(setting: LawSetting) -> list[Check]:
    """Rounding decides nothing, neither in the renderer nor in its input.

    The renderer compares numbers that are often equal, like depth in levels, to find the surfaces
    beside and behind a pixel. If last bits decided, other devices would render other pictures.
    """
    precision: list[float] = []
    inputs: list[float] = []
    for image, radius in probes.scenes():
        scene = Scenery(image.float(), radius.float())
        single, changed = (
            pictures(rendered(each, setting, torch.float32))
            for each in (scene, Scenery(*map(probes.rounded, scene)))
        )
        double = pictures(rendered(scene, setting, torch.float64))
        for off, others in ((precision, double), (inputs, changed)):
            off += [probes.worst_relative(a - b, b) for a, b in zip(single, others, strict=True)]
    measured = "float32 off float64, of the local maximum"
    return [
        Check("rounding", measured, "-", greatest(precision), 2e-5),
        Check("rounding", "last bits of the input, likewise", "-", greatest(inputs), 2e-5),
    ]


def devices(setting: LawSetting) -> list[Check]:
    """The CPU and the GPU render the same picture; without a GPU there is nothing to compare."""
    off: list[float] = []
    host = replace(setting, device="cpu")
    for scene in probes.scenes() if setting.device != "cpu" else []:
        on_device, on_cpu = (pictures(rendered(scene, s, torch.float32)) for s in (setting, host))
        off += [
            probes.worst_relative(a.cpu() - b, b) for a, b in zip(on_device, on_cpu, strict=True)
        ]
    value = greatest(off) if off else None
    return [Check("CPU and GPU", "difference, of the local maximum", "-", value, 1e-4)]


LAWS: tuple[Law, ...] = (
    discs,
    near_focus,
    white,
    left_and_right,
    focus,
    occlusion,
    tiles,
    same_bytes,
    rounding,
    symmetry,
    gradient,
    devices,
)
