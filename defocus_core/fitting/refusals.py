"""Why a blur is not what two pictures differ by: no pair, another cause, or beyond the range."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from defocus_core.fitting.pictures import offset_of, registered
from defocus_core.fitting.residual import Optics, Residual
from defocus_core.fitting.unknowns import MAX_MAGNIFICATION, MAX_SHIFT, Candidate

_WIDTH = 480  # px, of the pictures that are judged
_SMALL = 48  # px, of pictures whose blur hardly shows
_EXPLAINED = 1 / 3  # minimum fraction of the difference that a lens explains, before much noise
_ALL = 0.9  # fraction from which on nothing else is wrong, however much is blurred
_ALIKE = 0.5  # least correlation of pictures of one scene
_ONE_SCENE = 0.8  # that of pictures of one scene, of which one is put right
_MORE = 0.6  # of the error, or of what a correlation lacks, that is left by what explains more
_CLOSER = 0.85  # of the error of the sharp picture, that a shift leaves
_MOVED = 0.4  # px, the least shift that is proposed
_CHANGED = 0.02  # the least change of exposure or of gamma that is proposed; lack of correlation
_BOUND = 1 - 1e-9  # of the greatest magnification, which rounding leaves
_MINIMUM = 1e-6  # mean square of compressed light, that is no difference


class Refusal(NamedTuple):
    """Why a blur is not what two pictures differ by."""

    code: str  # a word of `defocus_core.errors.CODES`
    problem: str  # in words, without a full stop
    remedy: str  # what to do about it; options stand in angle quotes


class JudgedPair(NamedTuple):
    """What a blur makes, what is observed and what is sharp, in compressed light, [C, H, W]."""

    modelled: Tensor
    observed: Tensor
    sharp: Tensor
    weight: Tensor  # [1, H, W]

    @classmethod
    def of(cls, residual: Residual, point: Candidate, optics: Optics) -> JudgedPair:
        """That of a point; of a pair its mean."""
        scale = residual.scale(_WIDTH)
        modelled, weight, *_ = residual.modelled(point, optics, scale)
        minimum = 1e-9 / max(float(scale.disparity.abs().max()), 1e-9)
        sharp = replace(point, strength=minimum, focus=0.0)
        still = residual.modelled(sharp, optics, scale).light
        observed = torch.stack(scale.observed)
        modelled, observed, still = (
            residual.compressed(each.mean(0)) for each in (modelled, observed, still)
        )
        return cls(modelled, observed, still, weight.amin(0))

    def error(self, modelled: Tensor) -> float:
        """The mean square of what a picture differs from what is observed."""
        total = self.weight.sum().clamp_min(1e-9) * len(modelled)
        return float(((modelled - self.observed) ** 2 * self.weight).sum() / total)

    @property
    def explained(self) -> float:
        """The fraction of the difference between the pictures that the blur explains."""
        before = self.error(self.sharp)
        return 1 - self.error(self.modelled) / before if before > _MINIMUM else 0.0


def refusals_of(
    evidence: JudgedPair, options: dict[str, bool], point: Candidate
) -> Iterator[Refusal]:
    """Why a point is not the lens of two pictures, the plainest reason alone."""
    if evidence.error(evidence.sharp) <= _MINIMUM:
        yield Refusal(
            "not-explained",
            "the pictures do not differ: nothing is blurred",
            "give a picture that is blurred",
        )
        return
    of_small = _small_correlation(evidence.sharp, evidence.observed)
    cause = None if options["shift"] else _shift_cause(evidence, of_small)
    if cause is None and of_small >= _ALIKE:
        cause = _other_cause(evidence, options)
    alike = min(of_small, _correlation(evidence))
    if cause is not None:
        yield cause
    elif alike < _ALIKE and evidence.explained < _ALL:
        problem = f"the pictures do not show one scene: correlation {alike:.2f}"
        yield Refusal("not-one-scene", problem, "give a pair of one scene, as the camera saw it")
    elif evidence.explained < _EXPLAINED:
        fraction = max(evidence.explained, 0.0)
        problem = f"a blur explains {fraction:.0%} of what the pictures differ by"
        remedy = "see ‹shift›, ‹exposure› and ‹gamma›, or take it as it is by ‹accept›"
        yield Refusal("not-explained", problem, remedy)
    elif max(abs(point.across), abs(point.down)) >= MAX_SHIFT:
        problem = f"the pictures lie {MAX_SHIFT:g} px or more apart, as far as is sought"
        yield Refusal("out-of-range", problem, "crop them to the same place")
    elif abs(math.log(point.magnification)) >= _BOUND * math.log(MAX_MAGNIFICATION):
        problem = f"one picture is magnified by {MAX_MAGNIFICATION - 1:.0%} or more"
        yield Refusal("out-of-range", f"{problem}, as far as is sought", "scale it to the other")


def _shift_cause(evidence: JudgedPair, of_small: float) -> Refusal | None:
    """That one of the pictures lies beside the other, if that explains more than a blur."""
    for image, left in ((evidence.sharp, _CLOSER), (evidence.modelled, _MORE)):
        across, down = _offset(image, evidence.observed)
        there = registered(image[None], across, down, 1.0)[0]
        after = _small_correlation(there, evidence.observed)
        closer = of_small >= _ALIKE and evidence.error(there) < left * evidence.error(image)
        alike = after > _ONE_SCENE and max(1 - after, _CHANGED) < _MORE * (1 - of_small)
        if math.hypot(across, down) > _MOVED and (closer or alike):
            problem = f"a shift of ({across:.1f}, {down:.1f}) px explains more than a blur alone"
            return Refusal("other-cause", problem, "add ‹shift›")
    return None


def _other_cause(evidence: JudgedPair, options: dict[str, bool]) -> Refusal | None:
    """What explains more than a blur, if something does: the exposure or the gamma."""
    # a wrong lens hides a curve that the sharp picture shows
    images = evidence.modelled, evidence.sharp
    tried = (_curves(image, evidence.observed, evidence.weight) for image in images)
    before, (factor, _, scaled), (_, power, curved) = min(tried, key=lambda each: each[2][2])
    scaled = min(before, scaled)
    if not options["gamma"] and abs(power - 1) > _CHANGED and curved < _MORE * scaled:
        problem = f"a gamma of {power:.2f} explains more than a blur alone"
        return Refusal("other-cause", problem, "add ‹gamma›")
    if not options["exposure"] and abs(factor - 1) > _CHANGED and scaled < _MORE * before:
        problem = f"an exposure of {factor:.2f} times explains more than a blur alone"
        return Refusal("other-cause", problem, "add ‹exposure›")
    return None


def _small(image: Tensor) -> Tensor:
    """A picture [C, h, w] in which a blur hardly shows."""
    height = max(8, round(_SMALL * image.shape[1] / image.shape[2]))
    return interpolate(image[None], (height, _SMALL), mode="area")[0]


def _curves(
    modelled: Tensor, observed: Tensor, weight: Tensor
) -> tuple[float, tuple[float, float, float], tuple[float, float, float]]:
    """The error of small pictures; then factor, power and error by a factor, and by both."""
    modelled, observed, weight = (_small(each) for each in (modelled, observed, weight))
    x, y = (
        (c / (1 - c).clamp_min(1e-6)).clamp_min(1e-4).log().double() for c in (modelled, observed)
    )
    w = (weight * modelled * (1 - modelled)).double()  # where compressed light changes most
    mean_x, mean_y = ((w * each).sum() / w.sum().clamp_min(1e-12) for each in (x, y))
    slope = (w * (x - mean_x) * (y - mean_y)).sum() / (w * (x - mean_x) ** 2).sum().clamp_min(1e-12)

    def error(light: Tensor) -> float:
        return float((weight * (torch.sigmoid(light) - observed) ** 2).sum())

    lines = [(float((mean_y - k * mean_x).exp()), float(k)) for k in (1.0, slope)]
    fits = [(a, k, error(k * x + math.log(a))) for a, k in lines]
    return error(x), fits[0], fits[1]


def _offset(image: Tensor, observed: Tensor) -> tuple[float, float]:
    """The shift in px from a picture to another: whole px, then parts of them."""
    across, down = offset_of(image, observed, int(MAX_SHIFT))
    near = registered(image[None], across, down, 1.0)[0]
    slopes = torch.stack(torch.gradient(near, dim=(2, 1)))  # [2, C, H, W], along x and y
    border = int(MAX_SHIFT)
    inner = (..., slice(border, -border), slice(border, -border))
    slopes, away = slopes[inner].flatten(1).double(), (near - observed)[inner].flatten()
    normal = slopes @ slopes.T + 1e-12 * torch.eye(2, dtype=torch.float64)
    step = torch.linalg.solve(normal, slopes @ away.double()).clamp(-1, 1)
    return across + float(step[0]), down + float(step[1])


def _small_correlation(*pair: Tensor) -> float:
    """That of two pictures so small that a blur hardly shows."""
    first, second = (image - image.mean() for image in map(_small, pair))
    return float((first * second).sum() / (first.norm() * second.norm()).clamp_min(1e-12))


def _correlation(evidence: JudgedPair) -> float:
    """That of what a blur makes and what is observed, without what is wider than a sixteenth."""
    side = max(3, evidence.modelled.shape[2] // 16) | 1
    rest = []
    for image in (evidence.modelled, evidence.observed):
        wide = avg_pool2d(image[None], side, 1, side // 2, count_include_pad=False)[0]
        rest.append((image - wide) * evidence.weight.sqrt())
    norm = (rest[0].norm() * rest[1].norm()).clamp_min(1e-12)
    return float((rest[0] * rest[1]).sum() / norm)
