"""A picture too large to be held: read through windows, rendered region by region.

What comes out is, to the last bit, what `render` makes of the same picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.engine.frame import Frame
from defocus_core.engine.picture import Picture
from defocus_core.engine.region_schedule import total
from defocus_core.images.source import Pixels
from defocus_core.images.views import Views
from defocus_core.inpainting.known_layer import Behind
from defocus_core.layers.quality import find
from defocus_core.optics.aperture import Aperture
from defocus_core.runtime.torch_modes import own_modes
from defocus_core.runtime.validation import whole


class Stream:
    """The regions of a picture, in rows from the top, each from left to right.

    Attributes:
        size: (height, width) in px.
        frame: What holds for the whole picture, at the size at which it is rendered.
        repair: Of its depth.
        picture: What is rendered, at that size.
    """

    def __init__(
        self,
        image: Pixels,
        signed_radius: Pixels,
        *,
        aperture: Aperture | None = None,
        quality: str = "standard",
        left_right: bool = False,
        hidden: Behind | None = None,
        threads: int = 1,
        tile: int | None = None,
        infinity: float | None = None,
        depth_repair: str = "auto",
        hold: bool = False,
    ) -> None:
        """Look at the picture as a whole.

        Args:
            image: [C, H, W], linear light, premultiplied if it has alpha; a tensor or a `Source`.
            signed_radius: [H, W] px, negative nearer than focus, the same.
            aperture: As for `render`.
            quality: As for `render`.
            left_right: As for `render`.
            hidden: What is known behind the visible surface.
            threads: As for `render`.
            tile: As for `render`.
            infinity: As for `render`.
            depth_repair: As for `render`.
            hold: Whether there is room for repaired radii and the cells of a draft, together two
                thirds of the picture in float32; else those of a large one are made again wherever
                they are looked at.

        Raises:
            ValueError: If shapes do not match, or a number is not finite.
        """
        shape, size = tuple(image.shape), tuple(signed_radius.shape)
        if len(shape) != 3 or 0 in shape or shape[1:] != size:
            raise ValueError(
                f"image must be [C, H, W] and signed_radius [H, W], of a pixel at least, got "
                f"{shape} and {size}; one of a batch is image[0] and signed_radius[0, 0]"
            )
        for name, given in (("image", image), ("signed_radius", signed_radius)):
            if not (isinstance(given.dtype, torch.dtype) and given.dtype.is_floating_point):
                raise ValueError(
                    f"{name} must be of floats of torch, got {given.dtype}; "
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
        self._device = image.device
        with torch.no_grad(), own_modes(image.device):
            self.picture = Picture(
                image,
                signed_radius,
                aperture=Aperture() if aperture is None else aperture,
                quality=find(quality),
                left_right=left_right,
                hidden=known,
                threads=threads,
                tile=tile,
                infinity=infinity,
                depth_repair=depth_repair,
                hold=hold,
            )
        self.size: tuple[int, int] = self.picture.size
        self.frame: Frame = self.picture.frame
        self.repair: DepthRepair = self.picture.repair

    def regions(
        self,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Views]:
        """Compute them: images are [C, h, w], in float32 at least.

        Args:
            at_once: How many at once at most: bounds memory. None for as many as threads.
            progress: As for `render`.
        """
        at_once = None if at_once is None else whole("at_once", at_once, "None is as threads")
        self._counts.clear()
        # not around the loop: the mode would be that of whoever takes the regions, too
        with torch.no_grad():
            parts = self.picture.parts(at_once=at_once, progress=progress)
        while True:
            with torch.no_grad(), own_modes(self._device):
                part = next(parts, None)
                if part is None:
                    return
                self._counts.append(part.stats)
                found = part.to(self._dtype)
            yield found

    @property
    def stats(self) -> dict[str, int]:
        """Counts of what was computed and what was skipped, of the regions that are done."""
        return total(self.frame, self._counts)
