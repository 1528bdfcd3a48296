"""Samples of a deep OpenEXR part, nearest first in each pixel.

A sample with a ZBack beyond its Z fills a volume: its depth is the middle of these in 1 / distance,
so that its blur is the mean of the blurs at both ends.

The file is read without OpenImageIO, which gives samples to Python one by one, 5 µs each, and
allocates what a file promises before it can be counted. A chunk: the samples of a row, or of the
rows of a tile. Layout: openexr.com, "OpenEXR File Layout".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.header import DTYPES, MULTIPART, Channel, Header, channels_of, raw_headers
from defocus_core.io.exr.windows import Window
from defocus_core.io.read_files import damaged, once

_MAX_OF_TILE = 1 << 24  # px
# Decoded bytes of samples that any file may promise; beyond, decoded bytes per byte of the file.
# Cards of one colour have 200, and files made to fill the memory 1000.
_ANY, _RATIO = 1 << 26, 250
_COMPRESSIONS = NONE, ZIPS = 0, 2  # RLE is hardly written


class _Chunk(NamedTuple):
    """The header of a chunk: its position in px and in the file, and sizes in bytes."""

    y: int  # first row, in px from the corner of the data window
    x: int  # first column, in px from the corner of the data window
    at: int  # byte offset in the file of the table of counts; samples follow it
    table: int  # packed bytes of the table
    packed: int  # packed bytes of the samples
    unpacked: int  # unpacked bytes of the samples


class _Part(NamedTuple):
    """The layout of a deep part."""

    data: Window
    tile: tuple[int, int]  # (width, height) in px of a tile; of a row if there are no tiles
    compression: int  # the file format's number of the compression
    channels: tuple[Channel, ...]  # all, in the order of the file
    sample_bytes: int  # bytes of a decoded sample


@once
def count_samples(path: Path, header: Header) -> tuple[int, int]:
    """The number of samples in the fullest pixel, and that in all pixels; none is decoded."""
    with _open(path, header) as (file, part, chunks):
        counts = [_counts(file, part, chunk) for chunk in chunks if chunk.unpacked]
    maximum = max((int(count.max()) for count in counts), default=0)
    return maximum, sum(int(count.sum()) for count in counts)


@contextmanager
def _open(path: Path, header: Header) -> Iterator[tuple[BinaryIO, _Part, list[_Chunk]]]:
    """Yield the open file of a deep part, its layout and its chunks, whose size is checked."""
    try:
        with path.open("rb") as file:
            part, chunks = _layout(file, header)
            promised, size = sum(chunk.unpacked for chunk in chunks), path.stat().st_size
            if promised > max(_ANY, _RATIO * size):  # before anything is allocated for them
                problem = f"promises {promised // part.sample_bytes} deep samples in {size} bytes"
                remedy = "flatten it, or write it again"
                raise InputError("too-large", problem, remedy, path=path)
            yield file, part, chunks
    except (OSError, ValueError, KeyError, struct.error, zlib.error) as error:
        raise damaged(path, str(error)) from error


def _layout(file: BinaryIO, header: Header) -> tuple[_Part, list[_Chunk]]:
    """The layout of a part, and the headers of its chunks, whose positions are checked."""
    version, parts = raw_headers(file)
    start = file.tell()
    for before in parts[: header.index]:
        start += 8 * max(*struct.unpack("<i", before["chunkCount"].value), 0)
    attributes, data = parts[header.index], header.data
    is_tiled, tile = attributes["type"].value.startswith(b"deeptile"), (data.width, 1)
    if is_tiled:
        tile = struct.unpack_from("<II", attributes["tiles"].value)
    compression = attributes["compression"].value[0]
    channels = tuple(channels_of(attributes["channels"].value))
    if compression not in _COMPRESSIONS:
        raise ValueError(f"deep samples of compression {compression}, not none or ZIPS")
    if not 0 < tile[0] * tile[1] <= max(_MAX_OF_TILE, data.width):
        raise ValueError(f"tiles of {tile[0]}×{tile[1]} px")
    across, down = -(-data.width // tile[0]), -(-data.height // tile[1])
    sample_bytes = sum(np.dtype(DTYPES[channel.type]).itemsize for channel in channels)
    size, own = file.seek(0, 2), [header.index] if version & MULTIPART else []
    if start + 8 * across * down > size:
        raise ValueError("it ends early")
    file.seek(start)
    head = struct.Struct(f"<{'i' * len(own)}{'4i' if is_tiled else 'i'}3Q")
    chunks = []
    for number, (offset,) in enumerate(struct.iter_unpack("<Q", file.read(8 * across * down))):
        file.seek(min(offset, size))
        *place, table, packed, unpacked = head.unpack(file.read(head.size))
        row, column = divmod(number, across)
        at = offset + head.size
        if place != [*own, *([column, row, 0, 0] if is_tiled else [data.y0 + row])]:
            raise ValueError("a chunk is not where it should be")
        if at + table + packed > size:
            raise ValueError("it ends early")
        chunks.append(_Chunk(row * tile[1], column * tile[0], at, table, packed, unpacked))
    return _Part(data, tile, compression, channels, sample_bytes), chunks


def _unsorted(
    file: BinaryIO, part: _Part, chunks: Sequence[_Chunk]
) -> tuple[NDArray[np.int32], dict[str, NDArray[Any]]]:
    """The samples in the order of the file.

    Returns the pixel number [N] of each sample in the data window, and values [N] by channel.
    """
    values: dict[str, list[NDArray[np.generic]]] = {
        each.name: [np.zeros(0, DTYPES[each.type])] for each in part.channels
    }
    pixels: list[NDArray[np.int32]] = [np.zeros(0, np.int32)]
    for chunk in (chunk for chunk in chunks if chunk.unpacked):
        counts = _counts(file, part, chunk)
        data = _unpack(file.read(chunk.packed), chunk.unpacked, part.compression)
        y, x = (np.arange(n, dtype=np.int32) for n in counts.shape)
        number = (y[:, None] + chunk.y) * part.data.width + chunk.x + x
        pixels.append(np.repeat(number.ravel(), counts.ravel()))
        at = 0
        for of_row in counts.sum(1).tolist():
            for channel in part.channels:
                piece = np.frombuffer(data, DTYPES[channel.type], of_row, at)
                values[channel.name].append(piece)
                at += piece.nbytes
    return np.concatenate(pixels), {n: np.concatenate(values.pop(n)) for n in [*values]}


def _counts(file: BinaryIO, part: _Part, chunk: _Chunk) -> NDArray[np.int64]:
    """The number [h, w] of samples of each pixel of a chunk.

    Afterwards the file stands at the beginning of the samples.
    """
    rows = min(part.tile[1], part.data.height - chunk.y)
    columns = min(part.tile[0], part.data.width - chunk.x)
    file.seek(chunk.at)
    table = _unpack(file.read(chunk.table), 4 * rows * columns, part.compression)
    ends = np.frombuffer(table, "<i4").reshape(rows, columns).astype(np.int64)
    counts = np.diff(ends, axis=1, prepend=0)
    if (counts < 0).any() or int(ends[:, -1].sum()) * part.sample_bytes != chunk.unpacked:
        raise ValueError("its table of samples is wrong")
    return counts


def _unpack(data: bytes, size: int, compression: int) -> bytes:
    """The unpacked bytes, `size` in number; data that already have this size are not packed."""
    if compression == NONE or len(data) == size:
        unpacked = data
    else:  # bytes at even positions, then those at odd ones, as differences from the byte before
        steps = np.frombuffer(zlib.decompressobj().decompress(data, size + 1), np.uint8).copy()
        steps[1:] -= np.uint8(128)
        of_both = np.cumsum(steps, dtype=np.uint8)
        ordered, half = np.empty_like(of_both), (len(of_both) + 1) // 2
        ordered[0::2], ordered[1::2] = of_both[:half], of_both[half:]
        unpacked = ordered.tobytes()
    if len(unpacked) != size:
        raise ValueError(f"{len(unpacked)} bytes in place of {size}")
    return unpacked


ALPHA, DEPTH, BACK = _OF_LAYERS = "A", "Z", "ZBack"
_ROUNDING = 2e-3  # alpha that exceeds 1 by less was rounded to half


class DeepSamples(NamedTuple):
    """The samples of a window, sorted by pixel and in each pixel by depth."""

    window: Window
    pixel: NDArray[Any]  # [N] flat index in the window of each sample's pixel
    rank: NDArray[Any]  # [N] position of the sample in its pixel, 0 is the nearest
    # [N] by name of channel; alpha and depth of a view also by their names without the view
    values: dict[str, NDArray[Any]]

    @property
    def maximum(self) -> int:
        """The number of samples of the fullest pixel."""
        return int(self.rank.max(initial=-1)) + 1

    def dense(self, chosen: Any, values: NDArray[Any]) -> NDArray[Any]:
        """The values [N] of chosen samples, at most one per pixel, as an array [h, w]; else 0.

        `chosen`: indices or mask of the samples.
        """
        rows = np.zeros(self.window.height * self.window.width, values.dtype)
        rows[self.pixel[chosen]] = values[chosen]
        return rows.reshape(self.window.height, self.window.width)


def read_deep_samples(path: Path, header: Header) -> DeepSamples:
    """All samples of a deep part, with the channels that its header lists."""
    with _open(path, header) as (file, part, chunks):
        pixel, own = _unsorted(file, part, chunks)
    # Alpha and depth of a view get their names without the view
    names = {c.name: c.plain if c.plain in _OF_LAYERS else c.name for c in header.channels}
    values = {
        names[c.name]: own.pop(c.name).astype("u4" if c.type == "uint" else "f4", copy=False)
        for c in header.channels
    }
    alpha = values.get(ALPHA, np.ones(len(pixel), np.float32))
    if wrong := int(np.count_nonzero(~((alpha >= 0) & (alpha <= 1 + _ROUNDING)))):
        problem = f"has an alpha that is not between 0 and 1 in {wrong} samples"
        raise InputError("out-of-range", problem, "render or save it again", path=path)
    values[ALPHA] = np.minimum(alpha, 1)
    order = np.argsort(pixel, kind="stable")
    if DEPTH in values:
        values[DEPTH] = _middle(values[DEPTH], values.get(BACK, values[DEPTH]))
        depth = np.nan_to_num(values[DEPTH], nan=np.inf, posinf=np.inf)
        order = np.lexsort((depth, pixel))
    pixel, values = pixel[order], {name: values.pop(name)[order] for name in [*values]}
    values |= {name: values[plain] for name, plain in names.items()}
    return DeepSamples(header.data, pixel, ranks(pixel), values)


def ranks(pixel: NDArray[Any]) -> NDArray[np.int32]:
    """The position [N] of each sample in its pixel, from 0; `pixel`: ascending flat indices [N]."""
    return (np.arange(len(pixel)) - np.searchsorted(pixel, pixel)).astype(np.int32)


def seen(samples: DeepSamples) -> DeepSamples:
    """The samples that have alpha or light."""
    alpha, values = samples.values[ALPHA], samples.values
    if alpha.all():
        return samples
    light = [each for name, each in values.items() if name.rpartition(".")[2] in (*"RGBY",)]
    kept = np.logical_or.reduce([alpha > 0, *(each != 0 for each in light)])
    pixel, values = samples.pixel[kept], {name: each[kept] for name, each in values.items()}
    return DeepSamples(samples.window, pixel, ranks(pixel), values)


def _middle(front: NDArray[Any], back: NDArray[Any]) -> NDArray[Any]:
    """The depth of each sample: of a volume, its middle in 1 / distance; of a surface, its Z."""
    with np.errstate(divide="ignore", invalid="ignore"):
        between = 2 / (1 / front + 1 / back)
    return np.where((back > front) & (front > 0), between, front).astype(np.float32)
