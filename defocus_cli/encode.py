"""Images, written whole, in the format that the suffix says.

EXR: scene-linear half or float, with all channels and metadata. PNG (8 or 16 bit), TIFF (16 bit)
and JPEG (8 bit, quality 95): sRGB, clipped to 0…1, alpha unassociated; JPEG has no alpha, its
colour is what shows over black. The same pixels and attributes make the same bytes: no dates.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli.errors import InputError, UsageProblem, reason
from defocus_cli.exr import clamped_half, write_exr
from defocus_cli.files import quiet, unwritable, written_whole
from defocus_cli.transfer import linear_to_srgb, quantised

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

FORMATS = {".png": "png", ".tif": "tiff", ".tiff": "tiff", ".jpg": "jpeg", ".jpeg": "jpeg"}
_ROUNDING = 1e-5  # blurred white exceeds 1 by less, and it is below half a step of 16 bits
_OPTIONS: dict[str, dict[str, str | int]] = {
    "png": {"oiio:UnassociatedAlpha": 1, "png:compressionLevel": 4},
    "tiff": {"oiio:UnassociatedAlpha": 1, "Compression": "zip"},
    "jpeg": {"Compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
}


def write_image(
    path: Path,
    pixels: NDArray[np.float32],
    channels: Sequence[str],
    *,
    exr_type: str = "half",
    bits: int = 8,
    attributes: Mapping[str, object],
    extras: Mapping[str, NDArray[Any]] | None = None,
) -> list[str]:
    """Write an image.

    Args:
        path: its suffix says the format: exr, png, tif, tiff, jpg or jpeg.
        pixels: [H, W, C] scene-linear, premultiplied if A is among the channels.
        channels: names of the C channels, as `defocus_cli.images.Color`.
        exr_type: half or float, of the EXR's image channels.
        bits: 8 or 16, of a PNG.
        attributes: EXR metadata; other formats keep those that start with ``defocus:``.
        extras: further EXR channels, written with their own types; other formats drop them.

    Returns:
        What the file could not hold, one sentence each, for people.

    Raises:
        InputError: the file cannot be written.
        UsageProblem: a suffix of no known format.
    """
    if path.suffix.lower() == ".exr":
        return _write_exr(path, pixels, channels, exr_type, attributes, extras or {})
    if path.suffix.lower() not in FORMATS:
        problem = "has a suffix of no format that can be written"
        raise UsageProblem(path, problem, f"use .exr, {', '.join(FORMATS)}")
    codec = FORMATS[path.suffix.lower()]
    depth = {"png": bits, "tiff": 16, "jpeg": 8}[codec]
    encoded, warnings = display_encoded(pixels, channels, depth, keep_alpha=codec != "jpeg")
    told = {k: str(v) for k, v in attributes.items() if k.startswith("defocus:")}
    write_samples(path, encoded, codec, told)
    return warnings


def write_map(
    path: Path, values: NDArray[np.float32], channel: str, *, attributes: Mapping[str, object]
) -> None:
    """Write a float32 EXR with one channel, values [H, W].

    Raises:
        InputError: the file cannot be written.
    """
    import numpy as np

    write_exr(path, {channel: np.asarray(values, np.float32)}, attributes)


def display_encoded(
    pixels: NDArray[np.float32], channels: Sequence[str], bits: int, *, keep_alpha: bool
) -> tuple[NDArray[Any], list[str]]:
    """Linear, premultiplied pixels as sRGB integers, and what was lost on the way.

    Args:
        pixels: [H, W, C] scene-linear.
        channels: names of the C channels.
        bits: 8 or 16.
        keep_alpha: divide the colour by alpha and keep it, instead of leaving it over black.

    Returns:
        uint8 or uint16 [H, W, C'], and warnings.
    """
    import numpy as np

    warnings = []
    colour = np.asarray(pixels, np.float32)
    alpha = None
    if channels[-1] == "A":
        colour, alpha = colour[:, :, :-1], colour[:, :, -1:]
        if keep_alpha:
            colour = np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)
        else:
            warnings.append("alpha left out, colour shown over black")
    clipped = np.count_nonzero((colour > 1.0 + _ROUNDING).any(axis=2))
    if clipped:
        warnings.append(f"{clipped} pixels above 1 clipped")
    encoded = quantised(linear_to_srgb(colour), bits)
    if alpha is not None and keep_alpha:
        encoded = np.concatenate([encoded, quantised(alpha, bits)], axis=2)
    return encoded, warnings


def write_samples(
    path: Path, samples: NDArray[Any], codec: str, attributes: Mapping[str, str]
) -> None:
    """Write uint8 or uint16 samples [H, W, C] as they are.

    Args:
        path: written whole or not at all.
        samples: alpha, if any, unassociated.
        codec: png, tiff or jpeg.
        attributes: text to keep in the file where the format can.

    Raises:
        InputError: the file cannot be written.
    """
    encoded = _encoded(path, samples, codec, attributes)
    with written_whole(path) as file:
        file.write(encoded)


def _write_exr(
    path: Path,
    pixels: NDArray[np.float32],
    channels: Sequence[str],
    exr_type: str,
    attributes: Mapping[str, object],
    extras: Mapping[str, NDArray[Any]],
) -> list[str]:
    import numpy as np

    warnings = []
    image: NDArray[Any] = np.asarray(pixels, np.float32)
    if exr_type == "half":
        image, beyond = clamped_half(image)
        count = np.count_nonzero(beyond.any(axis=2))
        if count:
            warnings.append(f"{count} pixels beyond ±65504 clamped to half; float keeps them")
    planes = {name: image[:, :, index] for index, name in enumerate(channels)}
    write_exr(path, {**extras, **planes}, attributes)
    return warnings


def _encoded(path: Path, samples: NDArray[Any], codec: str, attributes: Mapping[str, str]) -> bytes:
    """Bytes of the file. ``path`` is for messages only."""
    import numpy as np
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    height, width, count = samples.shape
    spec = oiio.ImageSpec(width, height, count, samples.dtype.name)
    spec.channelnames = tuple({1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}[count])
    spec.alpha_channel = count - 1 if count in (2, 4) else -1
    settings = {**attributes, **_OPTIONS[codec], "oiio:ColorSpace": "sRGB"}
    # An empty DateTime keeps OpenImageIO from writing the current one.
    for name, value in {**settings, "Software": "defocus", "DateTime": ""}.items():
        spec.attribute(name, value)
    with quiet(), _memory(path) as memory:
        output = oiio.ImageOutput.create(codec)
        assert output is not None, f"OpenImageIO without {codec}"
        done = (
            output.open(str(memory), spec)
            and output.write_image(np.ascontiguousarray(samples))
            and output.close()
        )
        if not done:
            problem = f"cannot be encoded as {codec}: {reason(RuntimeError(output.geterror()))}"
            raise InputError(path, problem, "write EXR instead")
        return memory.read_bytes()


@contextmanager
def _memory(path: Path) -> Iterator[Path]:
    """A file name for an encoder to write to that no full disk can reach.

    On a full disk OpenImageIO's PNG encoder reports success, and its JPEG encoder ends the process.
    """
    try:
        if hasattr(os, "memfd_create"):
            number = os.memfd_create("defocus")
            try:
                yield Path(f"/proc/self/fd/{number}")
            finally:
                os.close(number)
        else:
            with tempfile.TemporaryDirectory() as directory:
                yield Path(directory) / "encoded"
    except OSError as error:
        raise unwritable(path, error) from error
