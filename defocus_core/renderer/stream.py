"""A picture too large to be held: read through windows, rendered region by region.

The regions are, to the last bit, what `render` makes of the same picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.renderer.engine.picture import FramedPicture
from defocus_core.renderer.engine.region_schedule import total
from defocus_core.renderer.engine.settings import STANDARD, Settings
from defocus_core.renderer.engine.shared_fill import FillOfColors
from defocus_core.renderer.inpainting.known_layer import Behind
from defocus_core.renderer.layers.stacked_samples import Layered
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.torch_modes import own_modes
from defocus_core.tensors.validation import whole
from defocus_core.tensors.views import Views


class Stream(FramedPicture):
    """The regions of a picture, in rows from the top, each from left to right."""

    def __init__(
        self,
        image: Pixels,
        signed_radius: Pixels,
        settings: Settings = STANDARD,
        hidden: Behind | None = None,
        *,
        layered: Layered | None = None,
        repair: DepthRepair | None = None,
        fill: FillOfColors | None = None,
        hold: bool = False,
    ) -> None:
        """Repair the depth, and prepare the frame.

        Args:
            image: [C, H, W], linear light, premultiplied if it has alpha; a tensor or a `Source`.
            signed_radius: [H, W] px, negative nearer than focus, the same.
            settings: The options of `render`.
            hidden: The known layer behind the visible surface.
            layered: The layers of which `image`, with alpha, is the `picture` in focus and
                `signed_radius` the `nearest` radius; the regions have alpha, too.
            repair: The repair by which `repair_depth` made the radii; None to repair them here.
            fill: Of some colours what `fill_for` of the picture continues for all.
            hold: Whether there is room for repaired radii and the coarse pixels of a draft,
                together two thirds of the picture in float32; without room those of a large picture
                are computed anew for each window.

        Raises:
            ValueError: If shapes do not match, a number is not finite, or a CoC does not fit
                psf_ks.
        """
        shape, size = tuple(image.shape), tuple(signed_radius.shape)
        if len(shape) != 3 or 0 in shape or shape[1:] != size:
            raise ValueError(
                f"image must be [C, H, W] and signed_radius [H, W], of a pixel at least, got "
                f"{shape} and {size}; one of a batch is image[0] and signed_radius[0, 0]"
            )
        for name, dtype in (("image", image.dtype), ("signed_radius", signed_radius.dtype)):
            if not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
                raise ValueError(
                    f"{name} must be of floats of torch, got {dtype}; "
                    "decode integers to linear light first"
                )
        known = hidden and Behind(*hidden)
        if known and [tuple(of.shape) for of in known] != [shape, size, size]:
            raise ValueError(
                f"hidden must be color, signed_radius and mask of {shape}, {size} and {size}, got "
                f"{[tuple(of.shape) for of in known]}; leave it out where nothing is known"
            )
        self._dtype = torch.promote_types(image.dtype, torch.float32)
        self._counts: list[dict[str, int]] = []
        with torch.no_grad(), own_modes(image.device):
            super().__init__(
                image,
                signed_radius,
                settings,
                known,
                layered=layered,
                repair=repair,
                fill=fill,
                hold=hold,
            )

    def regions(
        self,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Views]:
        """Compute the regions: images are [C, h, w], in float32 at least.

        Args:
            at_once: Greatest number of regions computed at once, which bounds memory; None for as
                many as threads.
            progress: As for `render`.
        """
        at_once = None if at_once is None else whole("at_once", at_once, "None is as threads")
        self._counts.clear()
        # not around the loop: the caller, who takes the regions, would get the modes, too
        with torch.no_grad():
            parts = self.parts(at_once=at_once, progress=progress)
        while True:
            with torch.no_grad(), own_modes(self.image.device):
                part = next(parts, None)
                if part is None:
                    return
                self._counts.append(part.stats)
                region = part.to(self._dtype)
            yield region

    @property
    def stats(self) -> dict[str, int]:
        """Counts of what was computed and what was skipped, of the regions that are done."""
        return total(self.frame, self._counts)
