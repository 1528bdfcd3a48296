"""A picture to be rendered: at its own size or, if the quality has it so, at half of that."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch

from defocus_core.aperture import Aperture
from defocus_core.assembly import Finished, finished
from defocus_core.enlarging import Enlarging
from defocus_core.frame import frame_of
from defocus_core.half_size import behind_at_half_size, half_size, means, radii_in_cells
from defocus_core.hidden import Behind
from defocus_core.quality import Quality
from defocus_core.slicing import SHARP
from defocus_core.source import Pixels, banded


class Picture:
    """One picture, and what holds for all of it.

    Attributes:
        size: (height, width) in px.
        at_half_size: Whether it is rendered in cells of two by two px.
        frame: What is rendered, in px or in cells.
        image: [C, h, w] of that; in cells, with one channel more.
        signed_radius: [h, w] of that, in px or in cells.
    """

    def __init__(
        self,
        image: Pixels,
        signed_radius: Pixels,
        *,
        aperture: Aperture,
        quality: Quality,
        left_right: bool,
        num_layers: int | None = None,
        psf_ks: int | None = None,
        hidden: Behind | None = None,
        threads: int = 1,
        tile: int | None = None,
        infinity: float | None = None,
    ) -> None:
        """Look at it as a whole; the arguments are those of `render`, for one picture.

        Raises:
            ValueError: If a value is not finite, or a CoC does not fit psf_ks.
        """
        given, self._threads = (image, signed_radius), threads
        self.size = signed_radius.shape[0], signed_radius.shape[1]
        exact = num_layers is not None or psf_ks is not None
        self.at_half_size = quality.half_size and not exact and _is_blurred(signed_radius)
        if self.at_half_size:
            quality = quality.in_cells()
            signed_radius = half_size(radii_in_cells, *given[::-1], threads=threads)
            image = half_size(means, image, threads=threads)
            hidden = None if hidden is None else behind_at_half_size(hidden, threads)
            infinity = None if infinity is None else infinity / 2
        self.frame = frame_of(
            image,
            signed_radius,
            aperture=aperture,
            quality=quality,
            left_right=left_right,
            num_layers=num_layers,
            psf_ks=psf_ks,
            hidden=hidden,
            threads=threads,
            tile=tile,
            infinity=infinity,
        )
        self.image, self.signed_radius, self._hidden = image, signed_radius, hidden
        self._enlarging: Enlarging | None = None
        if self.at_half_size:
            self._enlarging = Enlarging(self.frame, image, *given, threads=threads)
            self.image = self._enlarging.cells

    def parts(
        self,
        *,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Finished]:
        """The rendered picture, row by row, each from left to right.

        Args:
            at_once: Regions computed at once at most: bounds memory. None for as many as threads.
            progress: As for `render`.
        """
        parts = finished(
            self.frame,
            self.image,
            self.signed_radius,
            hidden=self._hidden,
            threads=self._threads,
            at_once=at_once,
            progress=progress,
        )
        return self._enlarging.enlarged(parts) if self._enlarging else parts


def _is_blurred(signed_radius: Pixels) -> bool:
    """Whether anything is out of focus."""
    ends = (torch.aminmax(band) for band in banded(signed_radius))
    return any(not (float(least) >= -SHARP and float(most) <= SHARP) for least, most in ends)
