"""Find the subject of a picture, for the default focus and blur of relative depth.

A single picture with relative depth can be rendered without a lens: the radius of its most blurred
pixel is `SHARE_OF_SIDE` of the longer side, and the surface of the subject is in focus. Depth in
metres needs a lens; the error proposes a complete command. In batches nothing is guessed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from defocus_core.errors import CALLER, UsageProblem
from defocus_core.io.depth_formats.depth import Depth, read_depth
from defocus_core.io.depth_formats.reading import DepthReading, own_format, require_size
from defocus_core.io.exr.header import is_exr
from defocus_core.io.images.describe import describe
from defocus_core.io.read_files import read_head
from defocus_core.request.job import PictureFiles, Reading, reading_through
from defocus_core.request.lens import LensValues
from defocus_core.request.parameters import BESIDE_BLUR, LENS_OPTIONS
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.quantities import Unitless
from defocus_core.request.resolver import Given, Layer, missing_options, missing_words, parsed
from defocus_core.system.text import command_line, note

SHARE_OF_SIDE = 0.02  # radius of the most blurred pixel, as a share of the longer side
# Of a subject: least share of the picture, weighted by a tent over height and width, and greatest
# share of the range of disparities. Share of the height in which disparity of an upright surface
# changes by less than `_STEP`. Share of the range within which disparities are about the same.
_LEAST_SHARE, _THICKNESS, _ABOVE, _ALIKE = 0.05, 1 / 6, 0.025, 0.02
_LOOKED_AT = 1 << 20  # pixels
# Within the share `_NEAR_BY` of the longer side, a surface changes by at most the share `_STEP` of
# the range of disparities: twice as much as a floor that spans the range in half of the picture.
_NEAR_BY, _STEP = 0.01, 0.04
# Greatest difference of disparity, as a share of the range, between the pixel in focus and the rest
# of its surface; and the rest of a floor, which has no end.
_AS_NEAR, _OF_FLOOR = 0.22, 0.075
_SEARCHED = 1 << 17  # pixels
_EVEN = 0.15  # evidence of the near end below which it is unknown
_UNFOCUSED = ("focus-at", "focus-value", "sharp-range")
_LENS = LensValues(85.0, 1.4, None)  # @portrait-85


class FoundPixel(NamedTuple):
    """The pixel to focus on, and (width, height) of its depth map."""

    x: int
    y: int
    size: tuple[int, int]

    def scaled(self, size: tuple[int, int]) -> tuple[int, int]:
        """The pixel (x, y) at the same position in a picture of another (width, height)."""
        x, y = (
            int((place + 0.5) * wanted / own)
            for place, wanted, own in zip(self[:2], size, self.size, strict=True)
        )
        return x, y


def subject_of(depth: Depth) -> FoundPixel:
    """Find the pixel to focus on: on the nearest upright surface that covers 5 % of the picture.

    Pixels in the middle of the picture count more. The disparities of the surface span at most a
    sixth of the range in the picture. Upright means that disparity does not change from row to row
    as on a floor. The pixel has about the median disparity of the surface, is near its centre, and
    not on a soft edge.
    """
    every, step = _looked_at(depth)
    known, standing = np.isfinite(every), _stands(every)
    if not known.any():
        return FoundPixel(depth.size[0] // 2, depth.size[1] // 2, depth.size)
    weight = np.outer(*(1 - np.abs((2 * np.arange(n) + 1) / n - 1) for n in every.shape))
    standing = standing if standing.any() else known
    order = np.argsort(-every[standing], kind="stable")
    nearest_first, weights = every[standing][order], weight[standing][order]
    thickness = _THICKNESS * _range(every)
    ends = np.searchsorted(-nearest_first, thickness - nearest_first, side="right")
    below = np.append(0.0, np.cumsum(weights))
    share = (below[ends] - below[:-1]) / weight[known].sum()
    first = int(np.argmax(share >= min(_LEAST_SHARE, share.max())))
    surface, weights = (each[first : ends[first]] for each in (nearest_first, weights))
    own = standing & (every <= surface[0]) & (every >= surface[-1])
    off = np.abs(every - surface[np.searchsorted(weights.cumsum(), weights.sum() / 2)])
    shown = own & ~on_ramp(every) if (own & ~on_ramp(every)).any() else own
    alike = np.argwhere(shown & (off <= off[shown].min() + _ALIKE * _range(every)))
    y, x = alike[np.argmin(np.hypot(*(alike - np.argwhere(own).mean(axis=0)).T))]
    return FoundPixel(step * int(x), step * int(y), depth.size)


def _stands(disparity: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where disparity [H, W] is about the same a little above or below, as on upright surfaces."""
    reach = max(1, round(_ABOVE * len(disparity)))
    framed = np.pad(disparity, [(reach, reach), (0, 0)], constant_values=np.nan)
    above, below = (
        np.abs(part - disparity) for part in (framed[: -2 * reach], framed[2 * reach :])
    )
    return np.asarray(np.fmin(above, below) <= _STEP / 2 * _range(disparity))


def _looked_at(depth: Depth) -> tuple[NDArray[np.float64], int]:
    """Subsampled disparities [h, w], greater is nearer, NaN if unknown; and their spacing in px."""
    step = math.isqrt(math.prod(depth.metres.shape) // _LOOKED_AT) + 1
    numbers = np.asarray(depth.metres[:][::step, ::step], np.float64)
    if depth.is_relative:
        known = np.where(np.isfinite(numbers), numbers, np.nan)
        return -known if depth.inverted else known, step
    with np.errstate(divide="ignore"):
        return np.where(numbers > 0, 1 / numbers, np.nan), step


def on_ramp(disparity: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where a disparity [H, W] lies between those of two surfaces nearby, as on a soft edge."""
    lowest, highest, step = _local_range(disparity)
    return np.asarray(np.minimum(disparity - lowest, highest - disparity) > step / 2)


def _local_range(disparity: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any], float]:
    """The least and the greatest disparity near each pixel; and their least difference at edges."""
    reach = max(1, round(_NEAR_BY * max(disparity.shape) / 2))
    lowest, highest = (_extreme(disparity, reach, end) for end in (np.fmin, np.fmax))
    return lowest, highest, _STEP * _range(disparity)


def _range(values: NDArray[Any]) -> float:
    return float(np.fmax.reduce(values, axis=None) - np.fmin.reduce(values, axis=None))


def _extreme(values: NDArray[Any], reach: int, end: np.ufunc) -> NDArray[Any]:
    """The least (`np.fmin`) or greatest (`np.fmax`) value within a square around each pixel.

    The square extends `reach` px to each side.
    """
    for axis in (0, 1):
        pads = [(reach, reach) if axis == each else (0, 0) for each in (0, 1)]
        padded = np.pad(values, pads, mode="edge")
        values = end.reduce(sliding_window_view(padded, 2 * reach + 1, axis), axis=-1)
    return values


def surface_of(depth: Depth, pixel: FoundPixel) -> Unitless | None:
    """The range of depth numbers of the surface at a pixel; None if there is only one number.

    The surface consists of upright pixels of similar disparity that are connected with the pixel.
    If no pixel is upright, it is a strip of the floor.
    """
    every, step = _looked_at(depth)
    finer = math.isqrt(every.size // _SEARCHED) + 1
    every, step = every[::finer, ::finer], step * finer
    lowest, highest, limit = _local_range(every)
    here = pixel.y // step, pixel.x // step
    smooth, stands = highest - lowest <= limit, _stands(every)
    if stands.any():
        smooth &= stands
    alike = np.argwhere(smooth & (np.abs(every - every[here]) <= limit))
    if not len(alike):
        return None
    place = tuple(alike[np.argmin(np.hypot(*(alike - here).T))])
    reach = (_AS_NEAR if stands.any() else _OF_FLOOR) * _range(every)
    whole = _connected(smooth & (np.abs(every - every[place]) <= reach), place)
    numbers = depth.metres[:][::step, ::step][whole]
    low, high = float(numbers.min()), float(numbers.max())
    return Unitless((low, high)) if low < high else None


def _connected(mask: NDArray[np.bool_], place: tuple[int, int]) -> NDArray[np.bool_]:
    """The connected component of `mask` [H, W] that contains the pixel (row, column)."""
    import torch

    from defocus_core.tensors.clipped_lights import Runs

    runs = Runs.from_mask(torch.from_numpy(mask))
    blob = runs.blobs()
    own = blob == blob[runs.holding(*(torch.tensor([at]) for at in place))]
    found = np.zeros(mask.shape, bool)
    for row, first, end in torch.stack(runs[:3], 1)[own].tolist():
        found[row, first:end] = True
    return found


def with_blur_and_focus(
    lenses: PictureLenses,
    pictures: Sequence[PictureFiles],
    reading: Reading,
    typed: Sequence[str],
    decoded: Depth | None = None,
) -> tuple[PictureLenses, Reading]:
    """Choose blur and focus for a single picture of relative depth, if they are not given.

    Args:
        lenses: The options given.
        pictures: The pictures to render; nothing is chosen for several.
        reading: Options for reading depth.
        typed: Words of the command line, for the command that an error proposes.
        decoded: The depth, if the picture is in memory.

    Returns:
        The lenses with blur and focus; and the options for reading, with ``invert`` if black is
        near.
    """
    if len(pictures) != 1 or pictures[0].frame is not None or lenses.is_complete:
        return lenses, reading
    picture, given = pictures[0], lenses.options
    relative = given.keys() <= BESIDE_BLUR
    if relative and decoded is not None:
        relative = decoded.is_relative
    elif relative and "blur" not in given:
        relative = is_relative(picture.depth, reading)
    if not relative:
        if decoded is None and (lacking := missing_options(given)):
            raise _incomplete(picture, reading, lacking, typed, has_file=lenses.file is not None)
        return lenses, reading
    near, path = "", picture.depth
    if reading.invert is None and (decoded is not None or not own_format(path)):
        reading, near = with_near_end(
            decoded or _depth_alone(picture, reading.as_relative()), reading
        )
    size, depth = size_of(picture) if decoded is None else decoded.size, None
    if not given.keys() & set(_UNFOCUSED):
        if decoded is not None:
            depth = replace(decoded, inverted=bool(reading.invert))
        else:
            depth = _depth_alone(picture, reading_through(reading, replace(_LENS, blur=1.0)))
            if picture.color != path:
                require_size(path, reading, depth.metres.shape, size)
    chosen = options_of(depth, size, given, whole_subject=lenses.file is None)
    words = [f"‹{name}› {each.text}" for name, each in chosen.items()]
    words += ["‹invert›"] if near and reading.invert else []
    if words or near:
        taken = f", taken with {' '.join(words)}" if words else ""
        note(f"defocus: {path}: relative depth{taken}{near}")
    return replace(lenses, own={**lenses.own, **chosen}), reading


def with_near_end(depth: Depth, reading: Reading) -> tuple[Reading, str]:
    """The reading options with ``invert`` set if black is near; and the evidence for it as text."""
    shown = white_is_near(depth)
    if abs(shown) < _EVEN:
        return reading, "; white is taken as near, add ‹invert› if black is"
    near, other, option = ("white", "black", "‹invert›")
    if shown < 0:
        reading, near, other, option = replace(reading, invert=True), other, near, "‹no-invert›"
    why = "by the bottom and the middle of the picture"
    return reading, f"; {near} is near {why}, add {option} if {other} is"


def white_is_near(depth: Depth) -> float:
    """Evidence, -2 to 2, that large numbers of relative depth are near; 0 is none.

    In most pictures, the bottom is nearer than the top, and the middle than the upper borders.
    """
    numbers = depth.metres[:: depth.metres.shape[0] // 256 + 1, :: depth.metres.shape[1] // 256 + 1]
    _, ranks, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    rank = ((np.cumsum(counts) - counts / 2) / numbers.size)[ranks.reshape(numbers.shape)]
    height, width = rank.shape
    high, wide = max(1, height // 6), max(1, width // 6)
    middle = rank[height // 4 : height - height // 4, width // 4 : width - width // 4]
    sides = (rank[: height // 2, :wide], rank[: height // 2, -wide:], rank[:high])
    borders = np.concatenate([side.ravel() for side in sides])
    return float(rank[-high:].mean() - rank[:high].mean() + middle.mean() - borders.mean())


def options_of(
    depth: Depth | None, size: tuple[int, int], given: Layer, *, whole_subject: bool = True
) -> dict[str, Given]:
    """Choose blur and focus for relative depth; options in `given` are left out.

    `depth` is needed only to find a focus; `size` is (width, height) in px. With `whole_subject`,
    all of the surface in focus becomes sharp.
    """
    chosen: dict[str, str] = {}
    if "blur" not in given:
        chosen["blur"] = f"{max(1, round(SHARE_OF_SIDE * max(size)))}px"
    if depth is not None and not given.keys() & set(_UNFOCUSED):
        subject = subject_of(depth)
        chosen["focus-at"] = "{},{}".format(*subject.scaled(size))
        if whole_subject and (numbers := surface_of(depth, subject)):
            chosen["sharp-range"] = LENS_OPTIONS["sharp-range"].text(numbers)
    return {name: parsed(name, text, CALLER.with_field(name)) for name, text in chosen.items()}


def _incomplete(
    picture: PictureFiles,
    reading: Reading,
    lacking: list[str],
    typed: Sequence[str],
    *,
    has_file: bool,
) -> UsageProblem:
    """The error for the missing lens options `lacking`, which proposes a command that has them.

    `typed` are the words of the command given; `has_file` tells whether it names a lens file.
    """
    words = list(typed)
    optics = [name for name in lacking if name != "focus"]
    if optics and not has_file:
        words += ["--lens", "@portrait-85"]
    else:
        words += [word for name in optics for word in (f"--{name}", LENS_OPTIONS[name].example)]
    if "focus" in lacking:
        subject = subject_of(_depth_alone(picture, reading))
        words += ["--focus-at", LENS_OPTIONS["focus-at"].text(subject.scaled(size_of(picture)))]
    problem, remedy = missing_words(lacking), f"run: {command_line(words)}"
    return UsageProblem("missing-option", problem, remedy, field=lacking[0])


def _depth_alone(picture: PictureFiles, reading: Reading) -> Depth:
    """The depth of a picture, not resized to its colour."""
    return read_depth(picture.depth, reading, lens_focal=_LENS.foclen / _LENS.sensor_width)


def size_of(picture: PictureFiles) -> tuple[int, int]:
    """Width and height of a picture in px, from the header of its colour file."""
    if picture.color != picture.depth:
        info = describe(picture.color)
    else:
        from defocus_core.io.depth_formats.photo_depth import sharp_original

        with sharp_original(picture.color) as sharp:
            info = describe(Path(sharp))
    return info.width, info.height


def is_relative(path: Path, reading: DepthReading) -> bool:
    """Whether a depth file holds numbers without a unit.

    That is assumed of 8-bit and 16-bit integers, HEIC, and GDepth without a unit, unless options
    say otherwise.
    """
    from defocus_core.io.depth_formats.photo_depth import read_jpeg
    from defocus_core.io.images.raster import choose_page

    head = read_head(path)
    if reading.says_scale or is_exr(head):
        return reading.relative
    if own := own_format(path):
        return own == "apple-heic" or "Units" not in read_jpeg(path).metadata
    part = choose_page(path, describe(path).parts, reading.part)
    return all(channel.type in ("uint8", "uint16") for channel in part.channels)
