"""A picture to be rendered: its depth repaired, at its own size or, for a draft, at half."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import repair_depth, repaired
from defocus_core.renderer.engine.draft_coarse import (
    behind_at_half_size,
    coarse_radii,
    half_size,
    means,
)
from defocus_core.renderer.engine.draft_enlarging import Enlarging
from defocus_core.renderer.engine.field import darkened
from defocus_core.renderer.engine.frame import Content, SharedFrame
from defocus_core.renderer.engine.preparation import computed_in, content_of, frame_of
from defocus_core.renderer.engine.region_schedule import rendered_regions
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.engine.shared_fill import FillOfColors, SharedFill
from defocus_core.renderer.engine.statistics import border_range, surveyed
from defocus_core.renderer.inpainting.frame_pyramid import EDGE
from defocus_core.renderer.inpainting.known_layer import Behind
from defocus_core.renderer.layers.quality import Quality, find
from defocus_core.renderer.layers.slice_radii import SHARP
from defocus_core.renderer.layers.stacked_samples import Layered
from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.source import Pixels, Scalar, banded
from defocus_core.tensors.views import Views


class FramedPicture:
    """A picture, and the frame that its regions share.

    Attributes:
        size: (height, width) in px.
        repair: Repair of its depth.
        at_half_size: Whether it is rendered in coarse pixels of two by two px.
        frame: The frame, in px or in coarse pixels.
        image: [C, h, w] pixels to render; at half size coarse pixels, with one channel more.
        signed_radius: [h, w] radii to render by, in px or in coarse pixels.
        layered: The layers of which it is the picture; None for a picture of its own.
        fill: What is continued for all colours of which these are some; None if it is not shared.
        reaching: [h, w] the radii whose light reaches farthest, in px or in coarse pixels.
    """

    def __init__(
        self,
        image: Pixels,
        signed_radius: Pixels,
        settings: Settings,
        hidden: Behind | None,
        *,
        layered: Layered | None = None,
        repair: DepthRepair | None = None,
        fill: FillOfColors | None = None,
        hold: bool = False,
        content: Content | None = None,
    ) -> None:
        """Repair the depth, and prepare the frame.

        Args:
            image: [C, H, W], linear light; of a batch [C, B, H, W].
            signed_radius: [H, W] px; of a batch [B, H, W].
            settings: The options.
            hidden: The known layer behind the visible surface.
            layered: The layers of which `image`, with alpha, and `signed_radius` are the picture;
                they are rendered as they are, not repaired and not at half size.
            repair: The repair by which the radii were made already; None to repair them here.
            fill: What is continued for all colours of which these are some; for a picture that is
                not rendered at half size.
            hold: Whether there is room for the repaired radii and the coarse pixels of a large
                picture that is no tensor; without room they are computed anew for each window.
            content: Of a batch whose radii are repaired and that is not rendered at half size, what
                all its pictures hold together.

        Raises:
            ValueError: If a value is not finite, or a CoC does not fit psf_ks.
        """
        if launches_cost(signed_radius.device):  # its memory is planned for one tile at once
            settings = replace(settings, threads=1)
        threads, quality = settings.threads, find(settings.quality)
        self.size = signed_radius.shape[-2], signed_radius.shape[-1]
        self.repair = DepthRepair() if repair is None else repair
        if settings.repair.on and layered is None and repair is None:
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
        self.at_half_size = content is None and by_scene and _is_blurred(signed_radius)
        if self.at_half_size:
            quality = quality.in_coarse_pixels()
            coarse = partial(half_size, threads=threads, hold=hold)
            self.image = coarse(means, image)
            self.signed_radius = coarse(coarse_radii, signed_radius, image)
            self._hidden = hidden and behind_at_half_size(hidden, threads, hold=hold)
        counted, self.reaching = self.image, self.signed_radius
        if layered is not None:
            counted = image[:-1] if isinstance(image, Tensor) else layered.picture(alpha=False)
            self.reaching = layered.most_blurred()
        self.fill = None if self.at_half_size or layered is not None else fill
        self.frame = frame_of(
            counted,
            self.signed_radius,
            settings,
            quality,
            self._hidden,
            content or self._content(counted, quality, threads),
            layered=layered,
            border=None if layered is None else border_range(self.reaching),
        )
        self._enlarging: Enlarging | None = None
        if self.at_half_size:
            self._enlarging = Enlarging(self.frame, self.image, image, signed_radius)
            self.image = self._enlarging.coarse

    def _content(self, counted: Pixels, quality: Quality, threads: int) -> Content:
        """What the picture holds, of whose pixels [C, h, w] count."""
        dtype = computed_in(counted, self.signed_radius)
        return content_of(
            surveyed(counted, self.signed_radius, dtype, threads),
            quality,
            quantised=self.repair.quantised and not self.at_half_size,
            uncertain=self.repair.uncertain_edges,
            layered=self.layered is not None,
            all_ranges=self.fill and self.fill.shared.limits,
        )

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
            fill=self.fill,
            reaching=self.reaching,
            at_once=at_once,
            progress=progress,
        )
        parts = self._enlarging.enlarged(parts) if self._enlarging else parts
        cat_eye = self.frame.settings.cat_eye
        if cat_eye is None or not cat_eye.vignetting:
            return parts
        return (darkened(part, cat_eye, self.size) for part in parts)


def shared_fill(
    image: Pixels,
    signed_radius: Pixels,
    settings: Settings,
    repair: DepthRepair,
    offsets: Sequence[Scalar],
    *,
    keep: bool = True,
) -> SharedFill | None:
    """What is continued for all colours that are rendered apart.

    None where gradients are wanted, or where no surface hides another.

    Args:
        image: [C, H, W], all channels.
        signed_radius: [H, W] px, repaired.
        settings: The options.
        repair: The repair of the radii.
        offsets: Px that are added to the radii of each group of colours.
        keep: Whether there is room to keep it for all of them; it is the same without.
    """
    requires_grad = (getattr(x, "requires_grad", False) for x in (image, signed_radius, *offsets))
    wanted = torch.is_grad_enabled() and any(requires_grad)
    if wanted or not any(_has_edges(band) for band in banded(signed_radius)):
        return None

    def frame() -> SharedFrame:
        return FramedPicture(image, signed_radius, settings, None, repair=repair).frame

    return SharedFill(frame, image, signed_radius, [float(px) for px in offsets], keep=keep)


def repaired_once(
    signed_radius: Pixels, image: Pixels, settings: Settings
) -> tuple[Pixels, DepthRepair]:
    """The radii by which all pictures of some settings are rendered, and their repair."""
    return repair_depth(
        signed_radius,
        image,
        settings.infinity,
        settings.threads,
        depth_repair=settings.depth_repair,
        edge_width=settings.edge_width,
        decided=settings.decided,
    )


def _has_edges(radii: Tensor) -> bool:
    """Whether surfaces hide others in a band [h, W] of radii."""
    steps = (radii.diff(dim=0), radii.diff(dim=1))
    return any(step.numel() > 0 and float(range_of(step).abs().amax()) > EDGE for step in steps)


def _is_blurred(signed_radius: Pixels) -> bool:
    """Whether a pixel is out of focus."""
    limits = (range_of(band).tolist() for band in banded(signed_radius))
    return any(not (minimum >= -SHARP and maximum <= SHARP) for minimum, maximum in limits)
