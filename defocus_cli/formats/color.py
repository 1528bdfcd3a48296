"""Colour images decoded for blurring: scene-linear float32, premultiplied by alpha.

EXR, HDR and float TIFF are linear already. 8 and 16 bit integers are sRGB unless the file declares
otherwise. EXR alpha is premultiplied by definition; other files' is multiplied in here, in linear
light.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from defocus_cli.exr.header import is_exr
from defocus_cli.exr.windows import NO_OVERSCAN, Overscan
from defocus_cli.formats.color_space import linear_light, unit
from defocus_cli.formats.float_maps import is_float_map
from defocus_cli.formats.raster import Raster, choose_page, read_pages, read_samples
from defocus_cli.system.arrays import IN_MEMORY, Keeping, bands, count_of
from defocus_cli.system.console import counted
from defocus_cli.system.errors import InputError, UsageProblem
from defocus_cli.system.safe_files import read_head

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

BRIGHTEST = 1e30  # light beyond it overflows in `defocus_core`, which refuses it too
LARGEST_FLOAT = float.fromhex("0x1.fffffep+127")  # of 32 bits


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
        overscan: pixels of the planes and the extras beyond the picture shown.
        note: how the samples were read, in words.
        warnings: what of the file was not applied, in words.
        left_out: parts of the EXR file that no output can carry, in words.
    """

    planes: tuple[Any, ...]
    channels: tuple[str, ...]
    path: Path
    attributes: Mapping[str, object] = field(default_factory=dict)
    extras: dict[str, Any] = field(default_factory=dict)
    pixel_aspect: float = 1.0
    corner: tuple[int, int] = (0, 0)
    overscan: Overscan = NO_OVERSCAN
    passes: tuple[str, ...] = ()
    note: str = ""
    warnings: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

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
        import numpy as np

        return np.stack(
            [plane[:] for plane in self.planes[: len(self.channels)]], axis=2, dtype=np.float32
        )


def read_color(
    path: Path,
    *,
    layer: str | None = None,
    part: int | None = None,
    view: str | None = None,
    keeping: Keeping = IN_MEMORY,
    overscan: Overscan = NO_OVERSCAN,
    blur_channels: Sequence[str] = (),
) -> Color:
    """Decode a colour image.

    Args:
        path: an EXR, HDR, PNG, JPEG or TIFF file.
        layer: which colour layer of an EXR file, as its error message lists them; PART/LAYER works.
        part: only look in this part of a multi-part EXR file, or page of a TIFF, counted from 0.
        view: which view of an EXR file of several; None for its default one.
        keeping: where the pixels are to be kept.
        overscan: pixels of an EXR file beyond its display window that are read, too.
        blur_channels: names or patterns of the further channels of an EXR file that are light.

    Raises:
        InputError: the file cannot be read, or has no colour or several to choose from.
        UsageProblem: a layer for a file that has none.
    """
    head = read_head(path)
    if is_exr(head):
        from defocus_cli.formats.exr_color import read_exr_color

        return read_exr_color(
            path,
            layer=layer,
            part=part,
            view=view,
            blur_channels=blur_channels,
            keeping=keeping,
            overscan=overscan,
        )
    if path.suffix.lower() == ".exr":
        raise InputError(path, "is not an OpenEXR file", "check what wrote it")
    if is_float_map(head):
        problem = "is a map of floats without colour"
        raise InputError(path, problem, "use EXR, PNG, JPEG, TIFF or HDR for colour")
    if layer is not None:
        raise UsageProblem("--color-layer", f"{path} has no layers", "leave it out")
    if blur_channels:
        raise UsageProblem("--blur-channels", f"{path} has no further channels", "leave it out")
    return _from_raster(path, choose_page(path, read_pages(path), part), keeping)


def count_beyond(color: Color, most: float) -> tuple[int, str]:
    """Number of pixels of a colour image that are NaN or beyond ±most, and the first as x,y."""
    import numpy as np

    return count_of(
        (
            ~np.logical_and.reduce([np.abs(p[rows]) <= np.float32(most) for p in color.planes]),
            rows.start,
        )
        for rows in bands(color.shape)
    )


def require_finite(color: Color) -> None:
    """Refuse a colour image whose pixels are not all finite and within ±`BRIGHTEST`.

    Raises:
        InputError: naming how many pixels are not, and the first as x,y.
    """
    count, first = count_beyond(color, BRIGHTEST)
    if not count:
        return
    infinite, first_infinite = count_beyond(color, LARGEST_FLOAT)
    if infinite:
        problem = f"is NaN or infinite in {counted(infinite, 'pixel')}, the first at"
        remedy = "render or save it again with finite values"
        raise InputError(color.path, f"{problem} {first_infinite}", remedy)
    problem = f"is beyond ±{BRIGHTEST:g} in {counted(count, 'pixel')}, the first at {first}"
    raise InputError(color.path, problem, "scale it: light has no unit here")


def _from_raster(path: Path, raster: Raster, keeping: Keeping) -> Color:
    import numpy as np

    if raster.deep:
        raise InputError(path, "holds deep data", "flatten it first")
    names = raster.channels
    wanted = "RGBA" if {"R", "G", "B"} <= set(names) else "YA"
    channels = tuple(c for c in wanted if c in names)
    if channels in ((), ("A",)):
        problem = f"has no colour channels (R, G, B or Y), only {', '.join(names)}"
        raise InputError(path, problem, "save it as RGB or grey")
    which = [names.index(c) for c in channels]
    size = raster.height, raster.width
    planes = tuple(keeping.new(size, np.float32) for _ in channels)
    for window, every in read_samples(path, raster.page):
        samples = every[:, :, which]
        alpha = unit(samples[:, :, -1:]) if channels[-1] == "A" else None
        colour = samples if alpha is None else samples[:, :, :-1]
        pixels = linear_light(colour, alpha, gamma=raster.space.gamma, associated=raster.associated)
        parts = pixels if alpha is None else np.concatenate([pixels, alpha], axis=2)
        for index, plane in enumerate(planes):
            plane[window] = parts[:, :, index]
    note, unheeded = raster.space.note, raster.space.unheeded
    if not unheeded:
        return Color(planes, channels, path, raster.tags, note=note)
    warning = f"its {unheeded} is not applied; convert it to sRGB, or to linear EXR"
    note = f"{note}, its {unheeded} not applied"
    return Color(planes, channels, path, raster.tags, note=note, warnings=(warning,))
