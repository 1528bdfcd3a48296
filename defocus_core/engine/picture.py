"""A picture to be rendered: its depth repaired, at its own size or, for a draft, at half."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import repaired
from defocus_core.engine.draft_cells import behind_at_half_size, half_size, means, radii_in_cells
from defocus_core.engine.draft_enlarging import Enlarging
from defocus_core.engine.field import darkened
from defocus_core.engine.preparation import frame_of
from defocus_core.engine.region_schedule import rendered_regions
from defocus_core.engine.settings import Settings
from defocus_core.images.neighbourhoods import ends_of
from defocus_core.images.source import Pixels, banded
from defocus_core.images.views import Views
from defocus_core.inpainting.known_layer import Behind
from defocus_core.layers.ladder import SHARP
from defocus_core.layers.quality import find
from defocus_core.layers.stacked_samples import Layered


class Picture:
    """A picture, and the frame that its regions share.

    Attributes:
        size: (height, width) in px.
        repair: Repair of its depth.
        at_half_size: Whether it is rendered in cells of two by two px.
        frame: The frame, in px or in cells.
        image: [C, h, w] pixels to render; at half size cells, with one channel more.
        signed_radius: [h, w] radii to render by, in px or in cells.
        layered: The layers of which it is the picture; None for a picture of its own.
        reaching: [h, w] the radii whose light reaches farthest, in px or in cells.
    """

    def __init__(
        self,
        image: Pixels,
        signed_radius: Pixels,
        settings: Settings,
        hidden: Behind | None,
        *,
        layered: Layered | None = None,
        hold: bool = False,
    ) -> None:
        """Repair the depth, and prepare the frame.

        Args:
            image: [C, H, W], linear light.
            signed_radius: [H, W] px.
            settings: The options.
            hidden: The known layer behind the visible surface.
            layered: The layers of which `image`, with alpha, and `signed_radius` are the picture;
                they are rendered as they are, not repaired and not at half size.
            hold: Whether there is room for the repaired radii and the cells of a large picture that
                is no tensor; without room they are computed anew for each window.

        Raises:
            ValueError: If a value is not finite, or a CoC does not fit psf_ks.
        """
        threads, quality = settings.threads, find(settings.quality)
        self.size = signed_radius.shape[0], signed_radius.shape[1]
        self.repair = DepthRepair()
        if settings.repair.on and layered is None:
            signed_radius, self.repair = repaired(
                signed_radius,
                image,
                infinity=settings.infinity,
                threads=threads,
                hold=hold,
                options=settings.repair,
                decided=settings.decided,
            )
        self.image, self.signed_radius, self._hidden = image, signed_radius, hidden
        self.layered = layered
        if layered is not None:
            quality = quality.of_layers(layered.deepest)
        by_scene = quality.half_size and settings.by_scene
        self.at_half_size = by_scene and _is_blurred(signed_radius)
        if self.at_half_size:
            quality, cells = quality.in_cells(), partial(half_size, threads=threads, hold=hold)
            self.image = cells(means, image)
            self.signed_radius = cells(radii_in_cells, signed_radius, image)
            self._hidden = hidden and behind_at_half_size(hidden, threads, hold=hold)
        counted, self.reaching = self.image, self.signed_radius
        if layered is not None:
            counted = image[:-1] if isinstance(image, Tensor) else layered.picture(alpha=False)
            self.reaching = layered.most_blurred()
        self.frame = frame_of(
            counted,
            self.signed_radius,
            settings,
            quality,
            self._hidden,
            quantised=self.repair.quantised and not self.at_half_size,
            uncertain=self.repair.uncertain_edges,
            layered=layered,
        )
        self._enlarging: Enlarging | None = None
        if self.at_half_size:
            self._enlarging = Enlarging(self.frame, self.image, image, signed_radius)
            self.image = self._enlarging.cells

    def parts(
        self,
        *,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Views]:
        """The rendered picture in parts, row by row, each from left to right.

        Args:
            at_once: Greatest number of regions computed at once, which bounds memory; None for as
                many as threads.
            progress: As for `render`.
        """
        parts = rendered_regions(
            self.frame,
            self.image,
            self.signed_radius,
            self._hidden,
            layered=self.layered,
            reaching=self.reaching,
            at_once=at_once,
            progress=progress,
        )
        parts = self._enlarging.enlarged(parts) if self._enlarging else parts
        cat_eye = self.frame.settings.cat_eye
        if cat_eye is None or not cat_eye.vignetting:
            return parts
        return (darkened(part, cat_eye, self.size) for part in parts)


def _is_blurred(signed_radius: Pixels) -> bool:
    """Whether a pixel is out of focus."""
    ends = (ends_of(band).tolist() for band in banded(signed_radius))
    return any(not (least >= -SHARP and most <= SHARP) for least, most in ends)
