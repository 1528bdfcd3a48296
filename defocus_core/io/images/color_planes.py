"""A decoded colour image: its planes, and what of its file the output carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan, Window


@dataclass(frozen=True)
class Color:
    """A decoded colour image.

    Attributes:
        planes: arrays [H, W], half or float32, scene-linear, premultiplied: of the C channels, then
            of the passes.
        channels: names of the C channels: R, G, B or Y, then A if there is one.
        passes: names of further channels of light, blurred with the picture.
        path: the file.
        attributes: metadata for the output to carry: `Raw` of an EXR file, `Tag` of others.
        extras: the EXR file's other channels [H, W], native types, for the output to carry.
        pixel_aspect: width of a pixel by its height.
        corner: x and y of the first pixel shown, for an EXR output to be where the input is.
        data: the pixels that an EXR file has, of all its parts; None of other files.
        overscan: pixels of the planes and the extras beyond the picture shown.
        note: how the samples were read, in words.
        warnings: what of the file was not applied, in words.
        left_out: parts of the EXR file that no output can carry, in words.
        compression: the codec of an EXR file, like zip.
        within_white: whether its samples are integers, which hold no light beyond white.
        orientation: by which the picture was turned upright, as Exif counts them; 1 is not.
    """

    planes: tuple[Any, ...]
    channels: tuple[str, ...]
    path: Path
    attributes: Mapping[str, object] = field(default_factory=dict)
    extras: dict[str, Any] = field(default_factory=dict)
    pixel_aspect: float = 1.0
    corner: tuple[int, int] = (0, 0)
    data: Window | None = None
    overscan: Overscan = NO_OVERSCAN
    passes: tuple[str, ...] = ()
    note: str = ""
    warnings: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    compression: str = "zip"
    within_white: bool = False
    orientation: int = 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """(height, width, number of planes)."""
        height, width = self.planes[0].shape
        return height, width, len(self.planes)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture shown, in px."""
        rows, columns = self.overscan.shown(*self.planes[0].shape)
        return columns.stop - columns.start, rows.stop - rows.start

    @property
    def is_cut(self) -> bool:
        """Whether its EXR file lacks pixels of the picture."""
        (x, y), (width, height) = self.corner, self.size
        frame = Window(x, y, x + width - 1, y + height - 1).grown(self.overscan)
        return self.data is not None and not self.data.covers(frame)

    @property
    def alpha(self) -> Any:
        """The plane of alpha [H, W]; None if there is none."""
        return self.planes[len(self.channels) - 1] if self.channels[-1] == "A" else None

    @property
    def light(self) -> tuple[Any, ...]:
        """The planes of the picture's colour [H, W], without alpha."""
        return self.planes[: len(self.channels) - (self.channels[-1] == "A")]

    @property
    def pixels(self) -> NDArray[np.float32]:
        """The whole image, float32 [H, W, C]."""
        return np.stack(
            [plane[:] for plane in self.planes[: len(self.channels)]], axis=2, dtype=np.float32
        )
