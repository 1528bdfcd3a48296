"""Images encoded in the format of their suffix, and written completely or not at all.

PNG (8 or 16 bit), TIFF (16 bit), JPEG and WEBP (8 bit): sRGB, converted from the primaries that the
attributes declare, clipped to 0…1, alpha unassociated; JPEG has no alpha, its colour is composited
over black. If the attributes have an `Embedded` profile, its curve and its primaries are used
instead, and it is written. All but WEBP keep the `Tag` attributes of an input. The same pixels and
attributes give the same bytes: no date is added.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem, one_line
from defocus_core.io.arrays import bands
from defocus_core.io.images.color_space import Embedded, encoded_light, quantised
from defocus_core.io.images.primaries import (
    PROFILE,
    between_primaries,
    converted,
    declared_primaries,
)
from defocus_core.io.images.raster import OWN, OWN_CHANNEL, PLAIN_CHANNELS, Tag, set_tag
from defocus_core.io.read_files import damaged, decoded_rows, opened_image, quiet
from defocus_core.io.write_files import written_whole
from defocus_core.system.text import counted

FORMATS = {".png": "png", ".tif": "tiff", ".tiff": "tiff", ".jpg": "jpeg", ".jpeg": "jpeg"}
FORMATS[".webp"] = "webp"
Attributes = Mapping[str, str | int | Tag | Embedded]
_SOFTWARE = "defocus"
_ROUNDING = 1e-5  # light above 1 up to here is rounding: less than half a step of 16 bits
_HALF_LEVEL = 0.49  # greatest dither in steps: values that are a step except for rounding stay
_LOSSY = ("jpeg", "webp")
_OTHER_BYTES = 1 << 22  # greatest size of a file without its pixels: profile and tags
_OPTIONS: dict[str, dict[str, str | int]] = {
    "png": {"oiio:UnassociatedAlpha": 1, "png:compressionLevel": 4},
    "tiff": {"oiio:UnassociatedAlpha": 1, "Compression": "zip"},
    "jpeg": {"jpeg:subsampling": "4:4:4"},
    "webp": {"oiio:UnassociatedAlpha": 1},
}


def write_image(
    path: Path,
    planes: Sequence[Any],
    channels: Sequence[str],
    *,
    bits: int = 8,
    jpeg_quality: int = 95,
    attributes: Mapping[str, object],
    has_clipped: bool = True,
    smooth: Any = None,
) -> list[str]:
    """Write an image in the format of its suffix; returns warnings of losses, one clause each.

    Args:
        path: The file.
        planes: C arrays [H, W], scene-linear, premultiplied if A is among the C channels.
        channels: Names of the planes: R, G, B or Y, then A if there is one.
        bits: 8 or 16, of a PNG.
        jpeg_quality: 1 to 100, of JPEG and WEBP.
        attributes: By name; of these, `Tag`, `Embedded` and texts named ``defocus:*`` are written.
        has_clipped: Whether clipped light is a loss to warn of, not an overshoot of a blur.
        smooth: [H, W] bool, pixels to which dither is added in 8 bits, so that slopes show no
            bands; None for no dither.
    """
    if path.suffix.lower() not in FORMATS:
        problem = "has the suffix of a format that is not written"
        raise UsageProblem("wrong-type", problem, f"use .exr, {', '.join(FORMATS)}", path=path)
    codec = FORMATS[path.suffix.lower()]
    metadata = {
        name: value
        for name, value in attributes.items()
        if isinstance(value, Tag | Embedded) or (name.startswith(OWN) and isinstance(value, str))
    }
    if codec in _LOSSY:
        metadata["Compression"] = f"{codec}:{jpeg_quality}"
    depth, embedded = {"png": bits, "tiff": 16}.get(codec, 8), metadata.get(PROFILE)
    to_srgb = None if PROFILE in attributes else srgb_matrix(path, channels, attributes)
    gamma = embedded.gamma if isinstance(embedded, Embedded) else None
    if is_grey := codec == "webp" and channels[0] == "Y":  # WEBP has no grey
        metadata, gamma = {n: x for n, x in metadata.items() if n != PROFILE}, None
    encode = partial(display_encoded, channels=channels, bits=depth, keep_alpha=codec != "jpeg")
    encode = partial(encode, to_srgb=to_srgb, gamma=gamma)

    encoded, above, below, unknown = [], 0, 0, 0
    for rows in bands(planes[0].shape):
        strip = np.stack([plane[rows] for plane in planes], axis=2)
        dither = None if smooth is None or depth > 8 else _dither(rows, smooth[rows])
        samples, *clipped = encode(strip, dither=dither)
        unknown += int(np.isnan(strip).any(-1).sum())
        above, below = above + clipped[0], below + clipped[1]
        encoded.append(samples[:, :, [0, 0, *range(samples.shape[2])]] if is_grey else samples)
    write_samples(path, np.concatenate(encoded), codec, metadata)
    warnings = []
    if channels[-1] == "A" and codec == "jpeg":
        warnings.append("alpha left out, colour shown over black")
    if unknown:
        warnings.append(f"{counted(unknown, 'pixel')} NaN, written as black")
    if has_clipped or to_srgb is not None:
        lost = (above, "brighter than white shown as white"), (below, "below black shown as black")
        warnings += [f"{counted(count, 'pixel')} {words}" for count, words in lost if count]
    return warnings


def srgb_matrix(
    path: Path, channels: Sequence[str], attributes: Mapping[str, object]
) -> NDArray[np.float32] | None:
    """The matrix [3, 3] from the declared primaries to those of sRGB; None if none is needed."""
    if tuple(channels[:3]) != ("R", "G", "B"):
        return None
    try:
        return between_primaries(declared_primaries(attributes))
    except ValueError as error:
        problem = f"cannot be made sRGB: the chromaticities of its input span no colours: {error}"
        raise InputError("damaged", problem, "write them anew, or use EXR", path=path) from error


def _dither(rows: slice, smooth: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The dither [h, W, 1] of given rows, within ±0.5 of a step; 0 where not `smooth` [h, W]."""
    # spread evenly over any small square, by powers of the plastic number (Roberts 2018)
    y, x = np.arange(rows.start, rows.start + len(smooth))[:, None], np.arange(smooth.shape[1])
    offsets = ((0.5698402909980532 * y + 0.7548776662466927 * x) % 1 - 0.5) * _HALF_LEVEL * 2
    return (offsets * smooth).astype(np.float32)[:, :, None]


def display_encoded(
    pixels: NDArray[np.float32],  # [H, W, C] scene-linear
    channels: Sequence[str],
    bits: int,
    *,
    keep_alpha: bool,
    to_srgb: NDArray[np.float32] | None = None,
    gamma: float | None = None,  # of the power law that encodes the colours; None for sRGB's curve
    dither: NDArray[np.float32] | None = None,  # [H, W, 1], fractions of a step added to colours
) -> tuple[NDArray[Any], int, int]:
    """Linear, premultiplied pixels encoded as integers of a number of bits, alpha unassociated.

    `to_srgb`: matrix [3, 3] to the primaries of sRGB; None if the pixels have these. Returns uint8
    or uint16 [H, W, C'], and the numbers of pixels above white and below black.
    """
    count = len(channels) - (channels[-1] == "A")
    colour, alpha = np.split(np.asarray(pixels, np.float32), [count], axis=2)
    has_alpha = keep_alpha and count < len(channels)
    white: Any = alpha if has_alpha else np.float32(1.0)
    colour = converted(colour, to_srgb)
    # Compared before it is divided: where alpha is nearly 0, so is colour, and both are rounded.
    above = int(np.count_nonzero((colour > white + _ROUNDING).any(axis=2)))
    below = int(np.count_nonzero((colour < -_ROUNDING).any(axis=2)))
    if has_alpha:
        colour = np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)
    encoded = quantised(encoded_light(colour, gamma), bits, dither)
    if has_alpha:
        encoded = np.concatenate([encoded, quantised(alpha, bits)], axis=2)
    return encoded, above, below


def write_map(path: Path, plane: Any, channel: str = "Z") -> None:
    """Write numbers [H, W] unchanged as a float32 TIFF, with the channel's name in a tag."""
    # without a predictor, which some readers lack
    named: dict[str, str | int] = {"tiff:predictor": 1, OWN_CHANNEL: f"{OWN}{channel}"}
    write_samples(path, plane[..., None].astype("float32"), "tiff", named)


def write_samples(path: Path, samples: NDArray[Any], codec: str, attributes: Attributes) -> None:
    """Write uint8, uint16 or float32 samples [H, W, C] unchanged; alpha is unassociated."""
    with written_whole(path) as file:
        encode(path, file, samples, codec, attributes)


def encode(
    path: Path, file: BinaryIO, samples: NDArray[Any], codec: str, attributes: Attributes
) -> None:
    """Encode samples into an open new file, and decode it as a check; errors name ``path``."""
    # on a full disk PNG reports no error, JPEG ends the process, and WEBP never ends
    spec = _spec(samples, codec, attributes)
    _require_room(file, 2 * spec.image_bytes() + _OTHER_BYTES)
    name = f"/dev/fd/{file.fileno()}"  # cannot be replaced by a link meanwhile
    if error := _encoder_error(name, spec, samples, codec) or _reader_error(Path(name)):
        problem = f"cannot be encoded as {codec}: {one_line(error).rstrip('.')}"
        raise InputError("unwritable", problem, "write EXR instead", path=path)


def _require_room(file: BinaryIO, count: int) -> None:
    os.truncate(file.fileno(), count)  # refused beyond the limit of the process
    os.truncate(file.fileno(), 0)
    disk = os.fstatvfs(file.fileno())
    if disk.f_blocks and disk.f_bavail * disk.f_frsize < count:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _encoder_error(target: str, spec: Any, samples: NDArray[Any], codec: str) -> str:
    """Encode samples to the file `target`; returns the encoder's message, empty on success."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    with quiet():
        output = oiio.ImageOutput.create(codec)
        assert output is not None, f"OpenImageIO without {codec}"
        done = output.open(target, spec) and output.write_image(np.ascontiguousarray(samples))
        return "" if done and output.close() else output.geterror() or "no reason given"


def _reader_error(name: Path) -> str:
    """The message of the decoder of a file; empty if all rows can be decoded."""
    try:
        with quiet(), opened_image(name, partial(damaged, name)) as file:
            spec = file.spec()
            every = (0, spec.height), (0, spec.nchannels)
            decoded_rows(name, file, 0, *every, str(spec.format))
    except InputError as error:
        return f"it cannot be read back, {error.problem}"
    return ""


def _spec(samples: NDArray[Any], codec: str, attributes: Attributes) -> Any:
    import OpenImageIO as oiio  # noqa: N813

    height, width, count = samples.shape
    number_type = "float" if samples.dtype.kind == "f" else samples.dtype.name
    spec = oiio.ImageSpec(width, height, count, number_type)
    spec.channelnames = tuple(PLAIN_CHANNELS[count])
    spec.alpha_channel = count - 1 if count in (2, 4) else -1
    # An empty DateTime keeps OpenImageIO from writing the current one.
    space = "lin_rec709" if samples.dtype.kind == "f" else "sRGB"
    settings = {"DateTime": "", **attributes, **_OPTIONS[codec], "oiio:ColorSpace": space}
    for name, value in {**settings, "Software": _SOFTWARE}.items():
        if isinstance(value, Tag):
            set_tag(spec, name, value)
        elif isinstance(value, Embedded):
            data = np.frombuffer(value.data, np.uint8)
            spec.attribute(name, oiio.TypeDesc(f"uint8[{len(data)}]"), data)
        else:
            spec.attribute(name, value)
    return spec
