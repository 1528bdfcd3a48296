"""Files that OpenImageIO decodes: PNG, JPEG, TIFF, HDR and whatever else it knows.

Samples come back as they are in the file: no colour conversion, and alpha not multiplied in (left
to itself, OpenImageIO multiplies it into sRGB integers, which loses precision and is not linear).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from defocus_cli.errors import InputError, one_line, reason
from defocus_cli.files import check_size, quiet, read_head

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

_SAMPLES = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float"}
_AGAIN = "write or copy it again"


@dataclass(frozen=True)
class Raster:
    """What an image file holds, turned upright as its Orientation says.

    Attributes:
        samples: uint8, uint16 or float32 [H, W, C], or None if only the header was read.
        width: in px.
        height: in px.
        channels: names, upper case for colour and alpha: R, G, B, A or Y.
        type: sample type in OpenImageIO's words.
        gamma: exponent of the decoding power law, 1 for linear, None for sRGB.
        associated: whether colour is already multiplied by alpha.
        deep: whether it holds deep data, which has no samples.
    """

    samples: NDArray[Any] | None
    width: int
    height: int
    channels: tuple[str, ...]
    type: str
    gamma: float | None
    associated: bool
    deep: bool


def read_raster(
    path: Path, *, pixels: bool = True, wanted: str = "EXR, PNG, JPEG, TIFF or HDR"
) -> Raster:
    """Decode the first image of a file, or only look at its header.

    Args:
        path: the file.
        pixels: whether to decode them.
        wanted: the formats to propose if it is of none that can be read.

    Raises:
        InputError: missing, empty, damaged, of unreasonable size, or not an image.
    """
    read_head(path)
    try:
        with quiet():
            return _read(path, pixels, wanted)
    except InputError:
        raise
    except Exception as error:
        raise InputError(path, f"cannot be read ({reason(error)})", _AGAIN) from error


def _read(path: Path, pixels: bool, formats: str) -> Raster:
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), config)
    if not file:
        why = oiio.geterror()
        told = "unknown format" if "format reader" in why else _first(path, why)
        problem = f"is not an image that can be read ({told})"
        raise InputError(path, problem, f"use {formats}")
    try:
        spec = file.spec()
        check_size(path, spec.width, spec.height, spec.pixel_bytes(True))
        samples = None
        if pixels and not spec.deep:
            wanted = _SAMPLES.get(str(spec.format))
            if wanted is None:
                problem = f"has samples of type {spec.format}"
                raise InputError(path, problem, "save it with 8, 16 or float samples")
            samples = file.read_image(0, 0, 0, spec.nchannels, wanted)
            # A truncated JPEG comes back filled with grey, and only the error flag says so.
            if samples is None or file.has_error:
                problem = f"is truncated or damaged ({_first(path, file.geterror())})"
                raise InputError(path, problem, _AGAIN)
    finally:
        file.close()
        oiio.geterror()  # or it would be told of the next file
    return _upright(spec, samples)


def _upright(spec: Any, samples: NDArray[Any] | None) -> Raster:
    """Samples and header with the Orientation that cameras write (EXIF 1 to 8) applied."""
    import numpy as np

    turn = spec.get_int_attribute("Orientation", 1)
    width, height = spec.width, spec.height
    if samples is not None:
        samples = samples.reshape(height, width, spec.nchannels)
        if turn in (5, 6, 7, 8):
            samples = samples.swapaxes(0, 1)
        if turn in (3, 4, 7, 8):
            samples = samples[::-1]
        if turn in (2, 3, 6, 7):
            samples = samples[:, ::-1]
        samples = np.ascontiguousarray(samples)
    if turn in (5, 6, 7, 8):
        width, height = height, width
    return Raster(
        samples=samples,
        width=width,
        height=height,
        channels=tuple(_canonical(spec)),
        type=str(spec.format),
        gamma=_gamma(spec),
        associated=not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
        deep=bool(spec.deep),
    )


def _canonical(spec: Any) -> Iterator[str]:
    """Channel names; a lone or first grey one is Y."""
    for index, name in enumerate(spec.channelnames):
        if index == spec.alpha_channel:
            yield "A"
        elif spec.nchannels <= 2 and index == 0:
            yield "Y"
        else:
            yield name


def _gamma(spec: Any) -> float | None:
    """How samples become linear light, from what the file declares and, failing that, its type."""
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    if space.startswith("lin") or space == "scene_linear":
        return 1.0
    if space.startswith("srgb"):
        return None
    declared = spec.get_float_attribute("oiio:Gamma", 0.0)
    if declared > 0:
        return float(declared)
    return 1.0 if str(spec.format) in {"half", "float", "double"} else None


def _first(path: Path, text: str) -> str:
    """First line of what OpenImageIO says, short enough for a message that names the file."""
    lines = text.replace(f' ("{path}")', "").strip().splitlines() or ["no reason given"]
    return one_line(lines[0]).rstrip(".")[:120]
