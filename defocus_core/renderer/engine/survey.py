"""The survey of a picture: statistics of all its pixels, computed before rendering."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.engine.limits import (
    BRIGHTER,
    BRIGHTEST,
    GREATEST_PX,
    ORDINARY,
    RANGE,
    SQUARED,
)
from defocus_core.tensors.neighbourhoods import range_of

# At most as many discs are drawn one by one, brightest first, as have the area of _FRAMES frames;
# but all that are _ALWAYS times as bright as ordinary pixels, as their rounding noise would be
# seen.
_FRAMES, _ALWAYS = 8.0, 100.0


class Survey(NamedTuple):
    """Statistics of a picture. The brightness of a pixel is that of its brightest channel."""

    minimum: float  # least signed radius in px
    maximum: float  # greatest signed radius in px
    # Greatest differences of radius between neighbours in px: down, across
    steepest: tuple[float, float]
    channels: tuple[tuple[float, float], ...]  # least and greatest value of each channel
    brightness: Tensor  # [H, W], at least 0
    ordinary: int  # number of pixels that are less bright than a highlight beside the brightest
    lit: int  # number of pixels that are not black
    dim: int  # number of lit pixels beside which float32 is too coarse for the brightest

    @property
    def darkest(self) -> float:
        """The least value of all channels."""
        return min(least for least, _ in self.channels)

    @property
    def brightest(self) -> float:
        """The greatest value of all channels."""
        return max(greatest for _, greatest in self.channels)


def surveyed(pixels: Tensor, signed_radius: Tensor, dtype: torch.dtype) -> Survey:
    """The statistics of a picture.

    `pixels`: [C, H, W]; `signed_radius`: [H, W] px.
    """
    radii, brightness = signed_radius.detach().to(dtype), None
    ranges = [range_of(radii)]
    for dim in (0, 1):
        step = radii.diff(dim=dim)
        ranges.append(range_of(step) if step.numel() else radii.new_zeros(2))
    for channel in pixels.detach():  # one at a time: they may be of half precision
        values = channel.to(dtype)
        ranges.append(range_of(values))
        brightness = values if brightness is None else brightness.maximum(values)
    assert brightness is not None
    brightness = brightness.clamp(min=0)
    brightest, black = brightness.amax(), brightness < torch.finfo(dtype).tiny
    dark = [brightness < brightest / BRIGHTER, black, brightness < brightest / RANGE]
    counts = torch.stack([mask.sum() for mask in dark])
    # one copy to the host; counts of pixels are exact in double precision
    together = torch.cat([torch.stack(ranges).flatten().double(), counts.double()]).tolist()
    *numbers, ordinary, unlit, dim = together
    (minimum, maximum), *others = zip(numbers[::2], numbers[1::2], strict=True)
    survey = Survey(
        minimum=minimum,
        maximum=maximum,
        steepest=(max(map(abs, others[0])), max(map(abs, others[1]))),
        channels=tuple(others[2:]),
        brightness=brightness,
        ordinary=int(ordinary),
        lit=brightness.numel() - int(unlit),
        dim=int(dim - unlit),
    )
    _check(survey, dtype)
    return survey


def _check(survey: Survey, dtype: torch.dtype) -> None:
    """Raise ValueError if radii or light are not finite, or too large to be rendered."""
    darkest, brightest, radii = survey.darkest, survey.brightest, (survey.minimum, survey.maximum)
    every = [end for ends in survey.channels for end in ends]
    for name, numbers in (("signed_radius", radii), ("image", every)):
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"{name} must be finite, got NaN or infinity; repair it first")
    if max(-survey.minimum, survey.maximum) > GREATEST_PX:
        raise ValueError(
            f"signed_radius must be within {GREATEST_PX:g} px, got {radii[0]:.3g} to "
            f"{radii[1]:.3g} px; check the units of depth and lens, and write inf for sky"
        )
    if max(-darkest, brightest) > float(torch.tensor(BRIGHTEST, dtype=dtype)):
        raise ValueError(
            f"image must be within ±{BRIGHTEST:g}, got {darkest:.3g} to {brightest:.3g}; "
            "scale it, light has no unit here"
        )


def border_range(signed_radius: Tensor) -> tuple[float, float]:
    """The least and the greatest of signed radii [H, W] on the edge of the frame."""
    r = signed_radius.detach()
    lines = torch.cat([line.flatten() for line in (r[:1], r[-1:], r[:, :1], r[:, -1:])])
    minimum, maximum = range_of(lines).tolist()
    return minimum, maximum


def highlight_limit(survey: Survey) -> float:
    """The brightness above which a pixel is a highlight."""
    pixels, radius = survey.brightness.numel(), max(-survey.minimum, survey.maximum, 1.0)
    # negative light is never a highlight, nor twice as much of it a bound
    maximum = max(survey.brightest, 0.0)
    rank = max(1, int(ORDINARY * pixels))
    if survey.ordinary < rank:
        return maximum
    drawn = max(1, int(_FRAMES * pixels / (math.pi * radius**2)))
    ordinary, beyond = (_of_rank(survey, k) for k in (rank, max(1, pixels - drawn)))
    share, power = math.frexp(beyond)  # of lights about as bright either all are drawn, or none
    beyond = math.ldexp(math.floor(256 * share) + 1, power - 8)
    return max(BRIGHTER * ordinary, min(beyond, _ALWAYS * ordinary, maximum))


def _of_rank(survey: Survey, rank: int) -> float:
    """The brightness of a rank, ascending from 1."""
    return float(survey.brightness.flatten().kthvalue(rank).values)


def needs_double(survey: Survey, limit: float) -> bool:
    """Whether float32 is not precise enough for a picture.

    Transforms in float32 round to 1e-7 of the brightest value, which shows in dark areas; squares
    of very bright colours overflow, and squares of very dark ones underflow. Pixels brighter than
    `limit` do not count: they are highlights, which are not transformed.
    """
    bright = min(survey.brightest, limit)
    size = max(bright, -survey.darkest)
    if size > SQUARED or 0 < size < 1 / SQUARED:
        return True
    if survey.dim < (survey.lit + 1) // 2:  # of the brightest, no darker than the limit
        return False
    dim = (survey.brightness < bright / RANGE).sum() - (survey.brightness.numel() - survey.lit)
    return survey.lit > 0 and int(dim) >= (survey.lit + 1) // 2
