"""Radii that are mended in each window as it is cut: the frame need not be in memory."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from defocus_core.derived import Derived
from defocus_core.source import Pixels
from defocus_core.tiling import Box


class Mended(Derived):
    """Radii [H, W] px, changed by what depends on a few pixels around."""

    def __init__(
        self,
        signed_radius: Pixels,
        mend: Callable[..., Tensor],
        around: int,
        *others: Pixels,
    ) -> None:
        """Nothing is looked at yet.

        Args:
            signed_radius: [H, W] px.
            mend: What changes them.
            around: Px around a pixel that decide what it becomes.
            others: What else of the frame, [..., H, W], is given to that.
        """
        self._given, self._mend, self._around = (signed_radius, *others), mend, around
        self.shape = tuple(signed_radius.shape)
        self.dtype = signed_radius.dtype
        self.device = signed_radius.device

    def made(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """Those from the first to before the end."""
        (top, below), (left, beside) = rows, columns
        box = Box(top, left, below - top, beside - left)
        around = box.grown(self._around, Box(0, 0, *self.shape[-2:]))
        return box.seen_from(around).of(self._mend(*map(around.of, self._given)))
