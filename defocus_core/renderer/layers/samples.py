"""Samples of pixels: those of one layer of the scene, and of layers sorted from near to far.

Samples of one pixel are uncorrelated within it: a sample shows through the share that all nearer
ones leave, so that the picture in focus is their `over` (Porter & Duff 1984). The share that shows
is visible, and the rest is hidden, except the part that its own surface hides: samples of one pixel
whose radii belong to one layer of slices are of one surface. The share of a pixel that no sample
covers is empty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.layers.alpha import Alpha
from defocus_core.renderer.layers.layer import SampleLayer
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import in_bands
from defocus_core.tensors.neighbourhoods import range_of

# Greatest radius in px: any picture is a point beside it.
_MAX_PX = 1e8
# Share of a pixel up to which coverage counts as rounding.
_MINIMUM = 1e-7
# Samples of one pixel are of one surface if their radii differ by less than half of this step, in
# px and as a share of the radius, and of two from the whole step on: no layer tells them apart.
_NEAR, _FAR = 1.0, 0.1
# Share of a pixel up to which an opaque sample may leave it clear.
_CLEAR = 0.01
# Samples of a pixel up to which each is compared with all others.
_FEW_SAMPLES = 8


class Layered(NamedTuple):
    """A scene of L layers with coverage, in any order."""

    colors: Tensor  # [L, C, H, W] linear, premultiplied by coverage; undefined where it is 0
    signed_radius: Tensor  # [L, H, W] px; undefined where coverage is 0
    coverage: Tensor  # [L, H, W] in [0, 1]
    limits: tuple[float, float]  # least and greatest signed radius in px where coverage is not 0
    open: bool  # whether there are pixels that are not fully covered
    deepest: int  # the greatest number of samples in one pixel
    with_alpha: bool = True  # whether its views have alpha, which is 1 where a picture covers all

    @classmethod
    def from_layers(cls, colors: Tensor, signed_radius: Tensor, coverage: Tensor) -> Layered:
        """The scene of the given layers, whose coverage and radii are checked."""
        cover = coverage.detach()
        if not bool(((cover >= 0) & (cover <= 1)).all()):
            raise ValueError(
                "coverage must be in [0, 1], got other numbers; it is the share of each pixel "
                "that a layer covers"
            )
        covered = cover > 0
        present = signed_radius.detach()[covered]
        if not bool((present.abs() <= _MAX_PX).all()):
            raise ValueError(
                f"signed_radius must be finite and within {_MAX_PX:g} px where coverage is "
                "above 0; check the units of depth and lens"
            )
        minimum, maximum = range_of(present).tolist() if len(present) else (0.0, 0.0)
        is_open = bool((cover < 1).all(0).any())
        if is_open:  # uncovered pixels are as far as the farthest surface, or in focus
            maximum = max(maximum, 0.0)
        deepest = max(1, int(covered.sum(0).amax()))
        return cls(colors, signed_radius, coverage, (minimum, maximum), is_open, deepest)

    def with_radii(self, signed_radius: Tensor) -> Layered:
        """The same layers with other radii."""
        layers = Layered.from_layers(self.colors, signed_radius, self.coverage)
        return layers._replace(with_alpha=self.with_alpha)

    @property
    def tensors(self) -> list[Tensor]:
        """All tensors of the layers."""
        return [self.colors, self.signed_radius, self.coverage]

    @property
    def dtype(self) -> torch.dtype:
        """The dtype to compute in."""
        of_colors = torch.promote_types(self.colors.dtype, torch.float32)
        return torch.promote_types(of_colors, self.signed_radius.dtype)

    @property
    def is_continued(self) -> bool:
        """Whether hidden surfaces are invented where no layer is known."""
        return self.deepest == 1 or not self.open

    def picture(self) -> Tensor:
        """The picture in focus [C + 1, H, W]: premultiplied colours, and alpha."""
        return self._read(lambda box: self.stack(box).flattened())

    @property
    def alpha(self) -> Alpha:
        """The source of the alpha of the views."""
        return Alpha.BLURRED if self.deepest == 1 else Alpha.COVERED

    def nearest(self) -> Tensor:
        """The signed radius [H, W] px of the nearest sample of each pixel."""
        return self._read(lambda box: self.radii(box)[0].amin(0))

    def most_blurred(self) -> Tensor:
        """The signed radius [H, W] px of the most blurred sample of each pixel."""

        def most_blurred(box: Box) -> Tensor:
            radii, coverage = self.radii(box)
            blurred = torch.where(coverage > 0, radii.detach(), 0.0)
            nearest, farthest = blurred.amin(0), blurred.amax(0)
            return torch.where(farthest > -nearest, farthest, nearest)

        return self._read(most_blurred)

    def _read(self, function: Callable[[Box], Tensor]) -> Tensor:
        """A picture [..., H, W], computed by `function` for one box after another."""
        _, _, height, width = self.colors.shape
        size, device = (height, width), self.colors.device
        return in_bands(lambda box: function(box).to(self.dtype), size, device)

    def radii(self, box: Box) -> tuple[Tensor, Tensor]:
        """Radii, or the greatest of the scene where coverage is 0, and coverage: [L, h, w] each."""
        radius, coverage = (box.crop(x).to(self.dtype) for x in (self.signed_radius, self.coverage))
        return torch.where(coverage > 0, radius, self.limits[1]), coverage

    def stack(self, box: Box, dtype: torch.dtype | None = None) -> SampleStack:
        """The samples of the pixels in a box, nearest first.

        Samples of equal radius are in the order of layers.
        """
        dtype = dtype or self.dtype
        radius, coverage = self.radii(box)
        color = torch.where(coverage[:, None] > 0, box.crop(self.colors).to(dtype), 0.0)
        radius, coverage = radius.to(dtype), coverage.to(dtype)
        color = torch.cat([color, coverage[:, None]], 1)
        there = coverage > 0
        distance = torch.where(there, radius.detach(), torch.inf)
        if bool((distance[1:] < distance[:-1]).any()):
            order = ascending(distance)
            radius = radius.gather(0, order)
            color = color.gather(0, order[:, None].expand_as(color))
        maximum = max(1, int(there.sum(0).amax()))
        color, radius = color[:maximum], radius[:maximum]
        left = torch.cumprod(1 - color[:, -1], 0)
        through = torch.cat([torch.ones_like(left[:1]), left])
        return SampleStack(color, radius, through, self.alpha is Alpha.BLURRED)


class SampleStack(NamedTuple):
    """The samples of the pixels of a window, nearest first."""

    color: Tensor  # [L, C + 1, h, w], colours premultiplied by coverage, then coverage
    signed_radius: Tensor  # [L, h, w] px; the farthest radius where there is no sample
    # [L + 1, h, w], the share of each pixel that all nearer samples leave; last the share that
    # none covers
    through: Tensor
    with_alpha: bool  # whether the colours of samples have a last channel of 1, their alpha

    def flattened(self) -> Tensor:
        """The picture in focus [C + 1, h, w]: premultiplied colours, then alpha."""
        return (self.color * self.through[:-1, None]).sum(0)

    def opaque(self) -> Tensor:
        """The radii [L, h, w] px of opaque samples; infinite for other samples."""
        clear = self.color[:, -1] < 1 - _CLEAR
        return self.signed_radius.masked_fill(clear, torch.inf)

    def solid(self, farthest: float) -> Tensor:
        """The radius [h, w] px of the nearest opaque sample; `farthest` where there is none."""
        return self.opaque().amin(0).clamp(max=farthest)

    def known_behind(self, box: Box) -> tuple[Tensor, Tensor] | None:
        """Where the samples behind the nearest one are opaque together, and their greatest radius.

        Both are [h, w], in a box; where there is no such sample, the radius is the greatest of the
        scene. None if no pixel has a sample behind the nearest one.
        """
        if len(self.color) == 1:
            return None
        known = torch.prod(1 - self.color[1:, -1].detach(), 0) <= _CLEAR
        return box.crop(known), box.crop(self.signed_radius[-1])

    def visible(self) -> tuple[SampleLayer, ...]:
        """The visible layers: the nearest samples, then the visible shares of samples behind."""
        return self._weighted(self.through[:-1])

    def hidden(self) -> tuple[SampleLayer, ...]:
        """The layers of the hidden shares of samples; empty if nothing is hidden.

        A share is hidden if nearer samples of the same pixel, from other surfaces, cover it.
        """
        if len(self.color) == 1:
            return ()
        weights = self._hidden_weights()
        if not bool((weights * self.color[:, -1] > _MINIMUM).any()):
            return ()
        return self._weighted(weights)

    def _hidden_weights(self) -> Tensor:
        """The share [L, h, w] of each sample that nearer samples of other surfaces hide."""
        radii, cover = self.signed_radius, self.color[:, -1]
        weights, first = [], 0
        for k, radius in enumerate(radii):
            while k - first > _FEW_SAMPLES and bool((_separation(radius, radii[first]) > 1).all()):
                first += 1  # another surface, and so it is for all samples farther than this one
            not_hidden = torch.ones_like(radius)
            for nearer, covered in zip(radii[first:k], cover[first:k], strict=True):
                own = 1 - _separation(radius, nearer).clamp(0, 1)
                not_hidden = not_hidden * (1 - covered * own)
            weights.append((not_hidden - self.through[k]).clamp(min=0))
        return torch.stack(weights)

    def _weighted(self, weights: Tensor) -> tuple[SampleLayer, ...]:
        """The samples as layers, with their coverage times weights [L, h, w]."""
        layers = []
        for color, radius, weight in zip(self.color, self.signed_radius, weights, strict=True):
            cover = color[-1:]
            color = color if self.with_alpha else color[:-1]
            color = color / torch.where(cover > 0, cover, 1.0)
            layers.append(SampleLayer(color, cover * weight, radius, sparse=True))
        return tuple(layers)


def _separation(radius: Tensor, nearer: Tensor) -> Tensor:
    """How separate two radii in px are: 0 or less if of one surface, 1 or more if of two.

    `radius`, `nearer`: [h, w]; `nearer` is the smaller one.
    """
    step = _NEAR + _FAR * torch.maximum(nearer.abs(), radius.abs())
    return 2 * (radius - nearer) / step - 1


def ascending(values: Tensor) -> Tensor:
    """The indices [L, h, w] that sort values in ascending order along L; the sort is stable."""
    return values.movedim(0, -1).sort(dim=-1, stable=True)[1].movedim(-1, 0)
