"""One lens for each picture of a batch: pupils, rims and photodiodes side by side.

Numbers of theirs are [B, 1, 1], for pictures [..., B, H, W]; one number where all are the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye, Rim
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.parts import Part
from defocus_core.tensors.bands import Scalar
from defocus_core.tensors.torch_modes import requires_grad


@dataclass(frozen=True)
class _OfEach:
    """What each picture has one of."""

    each: tuple[Any, ...] = ()

    @property
    def requires_grad(self) -> bool:
        """Whether gradients flow to any of them."""
        return requires_grad(self.each)


def _are_one(each: Sequence[object]) -> bool:
    """Whether pictures have the same, and no gradients flow to it."""
    return all(one == each[0] for one in each) and not any(map(requires_grad, each))


@dataclass(frozen=True)
class Apertures(_OfEach, Aperture):
    """The pupils of the pictures, of one profile and with the same parts."""

    each: tuple[Aperture, ...] = ()  # the pupil of each picture

    @classmethod
    def of(cls, each: Sequence[Aperture]) -> Aperture:
        """The pupils of pictures; one pupil if all have the same."""
        if _are_one(each):
            return each[0]
        return cls(psf_type=each[0].psf_type, each=tuple(each))

    @property
    def fixed(self) -> Self:
        """The same pupils with plain numbers for tensors."""
        return replace(self, each=tuple(one.fixed for one in self.each))

    def seeing(self, view: Rim | None) -> Iterator[tuple[Aperture, Rim | None]]:
        """Each pupil with its own view."""
        views = view.each if isinstance(view, Rims) else [view] * len(self.each)
        return zip(self.each, views, strict=True)

    def parts(self, count: int) -> list[Part]:
        """The parts, which are those of any of them."""
        return self.each[0].parts(count)

    def fraction(self, part: Part) -> Scalar:
        """The share of each pupil that lies in a part."""
        return _by_picture([one.fraction(part) for one in self.each])

    def centroid(
        self, part: Part, *, nearer: bool = False, view: Rim | None = None
    ) -> tuple[Scalar, Scalar]:
        """The mean lens point of a part of each."""
        each = self.seeing(view)
        return _pairs([one.centroid(part, nearer=nearer, view=seen) for one, seen in each])

    def first_moments(self, radius: float, part: Part) -> tuple[Scalar, Scalar]:
        """Mean place of the kernel of a part of each, in px."""
        return _pairs([one.first_moments(radius, part) for one in self.each])


class Rims(NamedTuple):
    """The rims that a point of each picture sees."""

    each: tuple[Rim, ...]

    @classmethod
    def joined(cls, rims: Sequence[Rims]) -> Rims:
        """Rims of several points as one."""
        pictures = zip(*(one.each for one in rims), strict=True)
        return cls(tuple(Rim.joined(points) for points in pictures))


@dataclass(frozen=True)
class CatEyes(_OfEach, CatEye):
    """The barrels of the pictures, without vignetting."""

    each: tuple[CatEye, ...] = ()  # the barrel of each picture

    @classmethod
    def of(cls, each: Sequence[CatEye | None]) -> CatEye | None:
        """The barrels of pictures; one if all have the same, None for none."""
        if _are_one(each):
            return each[0]
        return cls(each=tuple(one for one in each if one is not None))

    def view(self, x: Scalar, y: Scalar, frame: tuple[int, int]) -> Rims:  # type: ignore[override]
        """The rims that points see, as `CatEye.view`."""
        return Rims(tuple(one.view(x, y, frame) for one in self.each))


@dataclass(frozen=True)
class DualPixels(_OfEach, DualPixel):
    """The photodiodes of the pictures, which differ in crosstalk alone."""

    each: tuple[DualPixel, ...] = ()  # the photodiodes of each picture

    @classmethod
    def of(cls, each: Sequence[DualPixel]) -> DualPixel:
        """The photodiodes of pictures; one pair if all have the same."""
        if _are_one(each):
            return each[0]
        return cls(each[0].model, measured=each[0].measured, each=tuple(each))

    @property
    def apart(self) -> Scalar:
        """How far left and right of each are apart."""
        return _by_picture([one.apart for one in self.each])


def _pairs(pairs: Sequence[tuple[Scalar, Scalar]]) -> tuple[Scalar, Scalar]:
    x, y = map(_by_picture, zip(*pairs, strict=True))
    return x, y


def _by_picture(values: Sequence[Scalar]) -> Scalar:
    """A number for each picture, [B, 1, 1] on the CPU; one number if all are the same."""
    first = values[0]
    if not any(isinstance(value, Tensor) or value != first for value in values):
        return first
    each = [torch.as_tensor(value, dtype=torch.float64, device="cpu") for value in values]
    return torch.stack(each).view(-1, 1, 1)
