"""A field of pupils: a picture of the pupil for each place of a grid over the frame.

Kernels that were measured over the frame are such pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from typing import Any

import torch
from torch import Tensor

from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.frame_grid import FrameGrid, GridMix
from defocus_core.optics.outline import Outline
from defocus_core.optics.pupil_image import PupilImage
from defocus_core.tensors.validation import dense, described


class PupilField(PupilImage, FrameGrid):
    """Pictures of the pupil as points beyond focus show it, over the frame.

    All have one middle, the centroid of their mean, and one radius, the farthest that one of them
    reaches. As a picture it is their mean, each with light of 1.
    """

    def __init__(self, kernels: Tensor) -> None:
        """Find the middle and the extent of the pictures.

        Args:
            kernels: [rows, columns, H, W], 0 or more; the scale of each does not matter.

        Raises:
            ValueError: If they are no pictures of finite numbers, or one of them is dark.
        """
        if not (isinstance(kernels, Tensor) and kernels.dim() == 4 and kernels.numel()):
            problem = f"kernels must be a tensor [rows, columns, H, W], got {described(kernels)}"
            raise ValueError(f"{problem}; one of a grid is a PupilImage")
        dense("kernels", kernels)
        self._kernels = kernels.detach().to("cpu", torch.float64)
        self.grid = kernels.shape[0], kernels.shape[1]
        self.pupils = [PupilImage(kernel) for kernel in self._kernels.flatten(0, 1)]
        mean = sum(kernel / kernel.sum() for kernel in self._kernels.flatten(0, 1))
        super().__init__(torch.as_tensor(mean))
        radius = max(pupil.reach(self._middle) for pupil in self.pupils)
        for pupil in (*self.pupils, self):
            pupil.about(self._middle, radius)
        keys = b"".join(pupil._key[1] for pupil in self.pupils) + repr(self.grid).encode()
        self._key = (self._key[0], blake2b(keys).digest())

    def transposed(self) -> PupilField:
        """The field of a frame with rows for columns."""
        return PupilField(self._kernels.transpose(0, 1).mT)

    def mixed(self, weights: Tensor) -> Outline:
        """Their openings, mixed by weights [G] or [n, G]."""
        return _Mixed(tuple(self.pupils), weights)


# The pupil as points of the frame see it: clipped by a rim, or mixed.
View = Rim | GridMix


def joined(views: Sequence[Any]) -> View:
    """Views of one kind as one, as so many points see it."""
    view: View = type(views[0]).joined(views)
    return view


@dataclass(frozen=True)
class _Mixed(Outline):
    """Pupils of one radius, each with light of 1 times its weight."""

    pupils: tuple[PupilImage, ...]
    weights: Tensor

    @cached_property
    def _scale(self) -> float:
        """The mean light of the pupils, so that areas are about those of one."""
        return sum(pupil.light for pupil in self.pupils) / len(self.pupils)

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The mix of theirs."""
        points = self.weights.reshape(-1, len(self.pupils)).to(x.device)
        x, y = (at.expand(len(points), *at.shape[-2:]) for at in (x, y))
        total = x.new_zeros(len(points), y.shape[-2], x.shape[-1])
        for pupil, weight in zip(self.pupils, points.unbind(1), strict=True):
            which = weight.nonzero()[:, 0]
            if len(which):
                area = pupil.cumulative_area(x[which], y[which])
                fraction = (weight[which] * (self._scale / pupil.light))[:, None, None]
                total = total.index_add(0, which, area * fraction)
        return total if self.weights.dim() > 1 else total[0]
