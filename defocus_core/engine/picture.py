"""A picture to be rendered: at its own size or, if the quality has it so, at half of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import DEPTH_REPAIRS, repaired
from defocus_core.engine.draft_cells import behind_at_half_size, half_size, means, radii_in_cells
from defocus_core.engine.draft_enlarging import Enlarging
from defocus_core.engine.preparation import frame_of
from defocus_core.engine.region_schedule import finished
from defocus_core.images.neighbourhoods import ends_of
from defocus_core.images.source import Pixels, banded
from defocus_core.images.tiling import BLOCK
from defocus_core.images.views import Views
from defocus_core.inpainting.known_layer import Behind
from defocus_core.layers.ladder import SHARP
from defocus_core.layers.quality import Quality
from defocus_core.optics.aperture import Aperture
from defocus_core.runtime.validation import described, flag, number, one_of, whole

_MOST_LAYERS = 1 << 16  # what depth in 16 bits tells apart


class Picture:
    """One picture, and what holds for all of it.

    Attributes:
        size: (height, width) in px.
        at_half_size: Whether it is rendered in cells of two by two px.
        frame: What is rendered, in px or in cells.
        image: [C, h, w] of that; in cells, with one channel more.
        signed_radius: [h, w] of that, in px or in cells.
        repair: Of its depth.
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
        depth_repair: str = "auto",
        hold: bool = False,
    ) -> None:
        """Look at it as a whole; the arguments are those of `render`, for one picture.

        Of a large one whose image and radii are no tensors, `hold` says whether there is room for
        its repaired radii and its cells; else they are made again wherever they are looked at.

        Raises:
            ValueError: If a value is not finite, an option is out of its range, or a CoC does not
                fit psf_ks.
        """
        left_right = flag("left_right", left_right)
        threads = whole("threads", threads, "it is how many tiles are computed at once")
        num_layers = _count("num_layers", num_layers)
        if num_layers is not None and num_layers > _MOST_LAYERS:
            problem = f"num_layers must be {_MOST_LAYERS} at most, got {num_layers}"
            raise ValueError(f"{problem}; None lets the scene decide")
        psf_ks = _count("psf_ks", psf_ks)
        tile = _count("tile", tile, least=BLOCK)
        infinity = _finite(infinity)
        depth_repair = one_of("depth_repair", depth_repair, DEPTH_REPAIRS)
        if not isinstance(aperture, Aperture):
            raise ValueError(
                f"aperture must be an Aperture, got {described(aperture)}; Aperture() is round"
            )
        self._threads, self._hidden = threads, hidden
        self.size = signed_radius.shape[0], signed_radius.shape[1]
        looked_at = partial(
            frame_of,
            aperture=aperture,
            left_right=left_right,
            num_layers=num_layers,
            psf_ks=psf_ks,
            threads=threads,
            tile=tile,
        )
        self.repair = DepthRepair()
        if depth_repair == "auto":
            signed_radius, self.repair = repaired(
                signed_radius, image, infinity=infinity, threads=threads, hold=hold
            )
        exact = num_layers is not None or psf_ks is not None
        self.at_half_size = quality.half_size and not exact and _is_blurred(signed_radius)
        self._enlarging: Enlarging | None = None
        if not self.at_half_size:
            self.image, self.signed_radius = image, signed_radius
            self.frame = looked_at(
                image,
                signed_radius,
                quality=quality,
                hidden=hidden,
                quantised=self.repair.quantised,
            )
            return
        if hidden is not None:
            self._hidden = behind_at_half_size(hidden, threads, hold=hold)
        looked_at = partial(looked_at, quality=quality.in_cells(), hidden=self._hidden)
        made = partial(half_size, threads=threads, hold=hold)
        cells, radii = made(means, image), made(radii_in_cells, signed_radius, image)
        self.frame = looked_at(cells, radii)
        self._enlarging = Enlarging(self.frame, cells, image, signed_radius, threads=threads)
        self.image, self.signed_radius = self._enlarging.cells, radii

    def parts(
        self,
        *,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Views]:
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


def _count(name: str, count: int | None, least: int = 1) -> int | None:
    return None if count is None else whole(name, count, "None lets the scene decide", least)


def _finite(infinity: float | None) -> float | None:
    if infinity is None or math.isfinite(radius := number("infinity", infinity, "in px")):
        return None if infinity is None else radius
    raise ValueError(f"infinity must be a finite radius in px, got {radius}; None if not known")


def _is_blurred(signed_radius: Pixels) -> bool:
    """Whether anything is out of focus."""
    ends = (ends_of(band).tolist() for band in banded(signed_radius))
    return any(not (least >= -SHARP and most <= SHARP) for least, most in ends)
