"""Causes that move pixels: shift, turn, scale, swaps of views, fields and tiles, crop.

And where a difference lies that no cause explains. A place is said if it tells something: much more
of the squared difference lies there than of the pixels, by the relative entropy of both shares.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    PART,
    Cause,
    Evidence,
    Explanation,
    blocks_in_turn,
    fitted_in_parts,
    sums_of_parts,
)
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import DecodedPicture
from defocus_core.compare.selection import beside_jumps, read_radius, widened
from defocus_core.errors import InputError

_Scale = Callable[[NDArray[Any]], NDArray[Any]]

_FRAME = 512  # px of the middle of a picture in which a shift is looked for
_PEAKS = 3  # of each correlation that are tried
_EXPLAINED = 0.05  # left of a difference, below which no further move is looked for
_LEAST_PART = 0.02  # px of a move that is looked at
_SHIFT_LEFT = 0.15  # of a difference that a shift may leave: parts of another frame move alike
_PARTS_LEFT = 0.62  # of a difference that parts which move on their own may leave
_TILES = (16, 32, 64, 128, 256, 512)  # px; each twice the one before
_MOST_TILES = 1500  # that may have been exchanged
_CHOSEN = 2500  # samples that choose a small move
_STEP = 1e-4  # px by which kernels of interpolation are moved for their slope
_ONE_MOVE = 0.45  # px by which moves of parts differ where all is one move, rounded


def _other_file(evidence: Evidence) -> Iterator[Explanation]:
    """B is another file that lies beside A."""
    rows, columns = evidence.places
    for name, planes in evidence.others.items():
        if all(n in planes and planes[n].shape == evidence.size for n in evidence.names):
            there = np.stack([planes[n][rows, columns] for n in evidence.names])
            left = evidence.left(np.nan_to_num(there.astype(np.float32)))
            yield Explanation(left, name.partition(":")[0], text=name)


def _flipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A mirrored or turned by right angles, or its halves or its rows in pairs exchanged."""
    y, x = evidence.places
    height, width = evidence.size
    up, back = height - 1 - y, width - 1 - x
    moves = [
        ("flipped", " left to right", y, back),
        ("flipped", " upside down", up, x),
        ("rotated", " by 180°", up, back),
        ("fields exchanged", ": even and odd rows", (y ^ 1).clip(0, height - 1), x),
    ]
    if height == width:
        moves += [
            ("rotated", " by 90° to the left", x, up),
            ("rotated", " by 90° to the right", back, y),
            ("flipped", " over its diagonal", x, y),
        ]
    if width % 2 == 0:
        half = (x + width // 2) % width
        moves.append(("left and right swapped", ": the halves of the picture", y, half))
    for name, how, rows, columns in moves:
        yield Explanation(evidence.left(evidence.at("a", rows, columns)), name, how)


def _cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside of a window, and as A within it."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    if all(plane[0].any() and plane[:, 0].any() and plane[-1].any() for plane in planes):
        return
    kept = np.logical_or.reduce([plane != 0 for plane in planes])
    if not kept.any():
        return
    (top, bottom), (left, right) = (
        np.flatnonzero(kept.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)
    )
    width, height = right - left + 1, bottom - top + 1
    if (height, width) != evidence.size:
        rows, columns = evidence.places
        inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
        left_over = evidence.left(np.where(inside, evidence.sampled[0], np.float32(0.0)))
        text = f"a crop: 0 outside of {width}x{height} at {left},{top}"
        values = {"window": [left, top, width, height]}
        yield Explanation(left_over, "crop", values=values, text=text)


def _tiles_exchanged(evidence: Evidence) -> Iterator[Explanation]:
    """Tiles of B are tiles of A of another place; a tile is known by the mean of its channels."""
    rows, columns = evidence.places
    pixels = evidence.pixels
    planes = [*pixels.a, *pixels.b, pixels.greatest]
    means = np.stack([np.nan_to_num(_means(plane, _TILES[0])) for plane in planes])
    for side in _TILES:
        if side > _TILES[0]:
            means = _means(means, 2)
        down, across = means.shape[1:]
        if down * across < 2:
            return
        flat = means.reshape(len(planes), -1)
        old, new = flat[: len(pixels.a)].T, flat[len(pixels.a) : -1].T
        differs = flat[-1] > 3 * np.median(flat[-1])
        moved = np.flatnonzero(differs)
        if differs.all() or not 0 < moved.size < _MOST_TILES:
            continue
        source = np.arange(down * across)
        apart = np.abs(new[moved][:, None] - old[None, moved]).sum(axis=2)
        source[moved] = moved[apart.argmin(axis=1)]
        tile = (rows // side).clip(0, down - 1) * across + (columns // side).clip(0, across - 1)
        whole = (rows < down * side) & (columns < across * side)
        step = source[tile] - tile
        step_y = (source[tile] // across - tile // across) * side * whole
        step_x = (source[tile] % across - tile % across) * side * whole
        predicted = evidence.at("a", rows + step_y, columns + step_x)
        if step.any():
            left, cost = evidence.left(predicted), 0.001 * _TILES.index(side)
            yield Explanation(left, "tiles exchanged", f": of {side} px", {"side": side}, cost)


def _means(planes: NDArray[Any], side: int) -> NDArray[np.float32]:
    """Means of the whole tiles of planes [..., H, W]."""
    down, across = (length // side for length in planes.shape[-2:])
    cut = planes[..., : down * side, : across * side]
    rows = cut.reshape(*planes.shape[:-2], down, side, across * side).mean(
        axis=-2, dtype=np.float32
    )
    means: NDArray[np.float32] = rows.reshape(*rows.shape[:-1], across, side).mean(axis=-1)
    return means


@lru_cache(maxsize=1)
def _offsets_tried(evidence: Evidence) -> list[tuple[float, int, int]]:
    """What shifts by whole pixels leave, and these, the best first."""
    rows, columns = evidence.places
    height, width = evidence.size
    tried: list[tuple[float, int, int]] = []
    for dx, dy in _offsets(evidence):
        y, x = rows - dy, columns - dx
        within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        predicted = evidence.at("a", y.clip(0, height - 1), x.clip(0, width - 1))
        tried.append((evidence.left(predicted, within), dx, dy))
    return sorted(tried, key=lambda each: (round(each[0], 2), abs(each[1]) + abs(each[2])))


def _shifted(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by whole pixels; what comes in at the border may be anything."""
    left, dx, dy = _offsets_tried(evidence)[0]
    if (dx, dy) != (0, 0):
        yield Explanation(left, "shifted", f" by ({dx}, {dy})", {"dx": dx, "dy": dy})


def _offsets(evidence: Evidence) -> list[tuple[int, int]]:
    """Shifts (dx, dy) worth trying: small ones, and peaks of the mean of channels in the middle."""
    rows, columns = (
        slice((n - min(n, _FRAME)) // 2, (n + min(n, _FRAME)) // 2) for n in evidence.size
    )
    a, b = (
        np.asarray(evidence.scaled(evidence.at(side, rows, columns).mean(axis=0)), "f4")[None]
        for side in ("a", "b")
    )
    peaks = (each[0] for each in _peaks(a, b, _PEAKS))
    return list(dict.fromkeys([*product((-1, 0, 1), (-1, 0, 1)), *chain.from_iterable(peaks)]))


def _peaks(a: NDArray[Any], b: NDArray[Any], count: int) -> Iterator[list[list[tuple[int, int]]]]:
    """The highest peaks (dx, dy) of correlations of windows [n, h, w], more and less whitened."""
    height, width = a.shape[1:]
    window = np.outer(*(np.hanning(n + 2)[1:-1].astype(a.dtype) for n in (height, width)))
    old, new = (np.fft.rfft2((v - v.mean(axis=(1, 2), keepdims=True)) * window) for v in (a, b))
    spectrum = np.conj(old) * new
    magnitude = np.abs(spectrum) + 1e-9 * float(np.abs(spectrum).max(initial=0.0)) + 1e-30
    for whitening in (1.0, 0.5):
        peaks = np.fft.irfft2(spectrum / magnitude**whitening, s=(height, width))
        flat = peaks.reshape(len(a), -1)
        places = np.argpartition(flat, -min(count, flat.shape[1]), axis=1)[:, -count:]
        dy, dx = np.divmod(places, width)
        dx, dy = dx - width * (dx > width // 2), dy - height * (dy > height // 2)
        yield [list(zip(x.tolist(), y.tolist(), strict=True)) for x, y in zip(dx, dy, strict=True)]


def _moved_a_little(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by fractions, turned or enlarged around the middle, with cubic interpolation.

    Shift, angle and scale are found by least squares on the gradient (Lucas and Kanade, 1981).
    """
    left, dx, dy = _offsets_tried(evidence)[0]
    if left <= _EXPLAINED or min(evidence.size) <= 16:
        return
    rows, columns = evidence.places
    far = max(evidence.size) / 2
    fits = np.flatnonzero(evidence.fits)
    fits = fits[:: max(1, len(fits) // _CHOSEN)]
    y, x = rows[fits] - (evidence.size[0] - 1) / 2, columns[fits] - (evidence.size[1] - 1) / 2
    names = [sorted(evidence.names, key=lambda name: name[-1:] not in "GY")[0]]
    aim, was = (
        evidence.scaled(evidence.at(side, rows[fits], columns[fits], names)) for side in ("b", "a")
    )
    for free in (2, 4):
        move = np.array([float(dy), float(dx), 0.0, 0.0])  # down, right, turn and growth at far
        for _ in range(8):
            inside, sums = _moved(evidence, rows[fits], columns[fits], move, far, names)
            moved, down, right = sums
            ways = [-down, -right, (right * y - down * x) / far, -(right * x + down * y) / far]
            design = np.stack([way[:, inside].ravel() for way in ways[:free]])
            rest = (aim - moved)[:, inside].ravel()
            step = np.linalg.lstsq(design @ design.T, design @ rest, rcond=None)[0].clip(-2, 2)
            move[:free] += step
            if np.abs(step).max() < 0.002:
                break
        if not np.isfinite(move).all() or np.abs(move).max() < _LEAST_PART:
            continue
        if np.square(rest).sum() > 0.7 * np.square((aim - was)[:, inside]).sum():
            continue
        name, text, values = _moved_words(move, far)
        left = _left_by_move(evidence, move, far)
        if name == "shifted" and left > _SHIFT_LEFT:
            continue
        cost = 0.01 + 0.02 * (free - 2)
        yield Explanation(left, name, values=values, cost=cost, text=text)


def _left_by_move(evidence: Evidence, move: NDArray[Any], far: float) -> float:
    """What a move leaves: light may have been interpolated as such, or as a screen shows it."""
    scales: list[tuple[_Scale, _Scale]] = [(evidence.scaled, evidence.unscaled)]
    if evidence.pixels.color:
        scales.append((evidence.light, evidence.stored))
    least = math.inf
    for weights, (scale, back) in product((keys, linear), scales):
        if least > _EXPLAINED:
            inside, sums = _moved(
                evidence, *evidence.places, move, far, evidence.names, scale, weights
            )
            least = min(least, evidence.left(back(sums[0]), inside))
    return least


def keys(t: Any) -> Any:
    """The cubic kernel of Keys (1981), with a = -1/2, at distances in px."""
    t = np.abs(t)
    return np.where(
        t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((2.5 - t / 2) * t - 4) * t + 2, 0)
    )


def linear(t: Any) -> Any:
    """The kernel of linear interpolation."""
    return np.maximum(1 - np.abs(t), 0)


def _moved(
    evidence: Evidence,
    rows: NDArray[Any],
    columns: NDArray[Any],
    move: NDArray[Any],
    far: float,
    names: Sequence[str],
    scale: _Scale | None = None,
    kernel: Callable[[Any], Any] = keys,
) -> tuple[NDArray[np.bool_], list[NDArray[Any]]]:
    """Places of A that were within it, and A there with its slopes down and right, [C, N]."""
    scale = scale or evidence.scaled
    height, width = evidence.size
    y, x = rows - (height - 1) / 2, columns - (width - 1) / 2
    at_y = rows - move[0] - (move[3] * y + move[2] * x) / far
    at_x = columns - move[1] - (move[3] * x - move[2] * y) / far
    inside = (at_y > 2) & (at_y < height - 3) & (at_x > 2) & (at_x < width - 3)
    top, left = np.floor(at_y).astype(np.intp), np.floor(at_x).astype(np.intp)
    taps = np.arange(-1, 3)[:, None]
    lines, row = (top + taps).clip(0, height - 1)[:, None], (left + taps).clip(0, width - 1)
    values = scale(evidence.at("a", lines, row, names))  # [C, 4, 4, N]
    (down, slope_down), (across, slope_across) = (
        (kernel(t), (kernel(t + _STEP) - kernel(t - _STEP)) / (2 * _STEP))
        for t in (at_y - top - taps, at_x - left - taps)
    )
    ways = ((down, across), (slope_down, across), (down, slope_across))
    return inside, [np.einsum("kn,jn,ckjn->cn", k, j, values) for k, j in ways]


def _moved_words(move: NDArray[Any], far: float) -> tuple[str, str, dict[str, float]]:
    """The name, words and numbers of a small move; what moves most gives the name."""
    dy, dx, turn, growth = (float(v) for v in move)
    degrees, scale = float(np.degrees(turn / far)), 1 + growth / far
    values = {"dx": dx, "dy": dy, "degrees": degrees, "scale": scale}
    ways = [f"shifted by ({dx:.2f}, {dy:.2f})"] * bool(np.hypot(dx, dy) > _LEAST_PART)
    ways += [f"rotated by {-degrees:.3g}° to the left"] * (abs(turn) > 0.1)
    ways += [f"scaled by {scale:.5g}"] * (abs(growth) > 0.1)
    strongest = max((np.hypot(dx, dy), "shifted"), (abs(turn), "rotated"), (abs(growth), "scaled"))
    ways.sort(key=lambda way: not way.startswith(strongest[1]))
    return strongest[1], " and ".join(ways) or strongest[1], values


def _moved_in_parts(evidence: Evidence) -> Iterator[Explanation]:
    """Parts of the picture have moved by different amounts: another view, or another frame."""
    tried = _offsets_tried(evidence)
    if tried[0][0] <= _EXPLAINED or min(evidence.size) < 3 * PART:
        return
    a, b = (evidence.scaled_light(side).astype(np.float64) for side in evidence.framed)
    candidates = list(
        dict.fromkeys([(0, 0), *_part_offsets(a, b), *((dx, dy) for _, dx, dy in tried)])
    )
    chooses = blocks_in_turn(a.shape, 4)
    costs, moved = [], []
    for dx, dy in candidates:
        there = _moved_by(a, dx, dy)
        costs.append(sums_of_parts(np.abs(there - b) * chooses))
        moved.append(there)
    order = np.argsort(np.stack(costs), axis=0, kind="stable")[0]
    chosen = np.repeat(np.repeat(order, PART, axis=0), PART, axis=1)[: a.shape[0], : a.shape[1]]
    predicted = np.take_along_axis(np.stack(moved), chosen[None], axis=0)[0]
    # What moves by fractions of a pixel add, by least squares on the gradient.
    predicted = predicted + fitted_in_parts(np.gradient(predicted), b - predicted, chooses)
    energy = sums_of_parts(np.square(b - a))
    moves = np.array(candidates, dtype="f8")[order]  # [h, w, 2]
    matter = energy > np.quantile(energy, 0.5)
    apart = _apart_from_one_move(moves, energy * matter)
    if apart < _ONE_MOVE or not matter.any():
        return
    (x0, y0), (x1, y1) = (choose(moves[matter], axis=0) for choose in (np.min, np.max))
    how = f": parts moved by {x0:.0f} to {x1:.0f} px across, {y0:.0f} to {y1:.0f} px down"
    left = evidence.left_framed(evidence.unscaled_light(predicted), ~chooses)
    yield Explanation(left, "another view or frame", how, cost=0.0 if apart > 1 else 0.1)


def _apart_from_one_move(moves: NDArray[Any], weights: NDArray[Any]) -> float:
    """RMS distance in px of moves [h, w, 2] of parts from those of one shift, turn and scale."""
    rows, columns = np.indices(weights.shape)
    root = np.sqrt(weights.ravel())
    design = np.stack([np.ones(root.size), rows.ravel(), columns.ravel()], axis=1) * root[:, None]
    aim = moves.reshape(-1, 2) * root[:, None]
    solved = np.linalg.lstsq(design, aim, rcond=None)[0]
    rest = float(np.square(aim - design @ solved).sum()) / max(float(weights.sum()), 1e-300)
    return math.sqrt(rest)


def _part_offsets(a: NDArray[Any], b: NDArray[Any]) -> list[tuple[int, int]]:
    """Moves (dx, dy) of windows of twice the size of a part, the most frequent first."""
    side = 2 * PART
    corners = product(*(range(0, max(n - side, 0) + 1, PART) for n in a.shape))
    cuts = [(slice(y, y + side), slice(x, x + side)) for y, x in corners]
    old, new = (np.stack([values[cut] for cut in cuts]) for values in (a, b))
    found = Counter(peak for each in _peaks(old, new, 1) for (peak,) in each)
    near = Counter({(x + dx, y): 0.3 for x, y in list(found) for dx in (-1, 1)})
    return [offset for offset, _ in (found + near).most_common(24)]


def _moved_by(values: NDArray[Any], dx: int, dy: int) -> NDArray[Any]:
    """Values [h, w] moved to the right and down; the border is repeated."""
    rows, columns = (
        (np.arange(n) - step).clip(0, n - 1) for n, step in zip(values.shape, (dy, dx), strict=True)
    )
    moved: NDArray[Any] = values[rows][:, columns]
    return moved


GEOMETRY = (
    Cause(_other_file),
    Cause(_flipped),
    Cause(_cropped),
    Cause(_tiles_exchanged),
    Cause(_shifted, _SHIFT_LEFT),
    Cause(_moved_a_little),
    Cause(_moved_in_parts, _PARTS_LEFT),
)


_Mask = NDArray[np.bool_]

_LOOKED_AT = 2**19  # pixels, of which every n-th row and column are kept
_TELLS = 0.35  # least relative entropy of a place, in nats
_MOST, _ONLY = 0.75, 0.9  # least shares of the difference
_FEWEST = 12.0  # pixels that would hold the difference if each held as much
_SHARP = 1.0  # px of the largest radius in focus
_EDGE_REACH = 2  # px around a silhouette
_BRIGHT, _BRIGHT_ON_SCREEN, _DARK = 1.0, 0.9, 0.1  # values as a screen shows them
_STEEPEST = 0.9  # quantile of the gradient beyond which there is an edge
_JUMP = 0.05  # of the range of inverse depth
_BORDERS = (1, 2, 4, 8, 16)  # px
_TAILS = 0.06  # share of the difference that lies beyond each end of a region
_ONE_SIGN = 0.9  # share of the squared difference that makes it brighter, or darker
_DEPTHS = ("Z", "depth.Z", "depth")  # channels


class LocatedPair:
    """A pair where its difference is looked at, and what is known of its scene.

    Attributes:
        evidence: the pair.
        cut: the rows and columns that are looked at.
        sides: A and B [C, h, w] on the scale of differences.
        power: the squared difference [h, w], with the sign of the difference.
        maps: signed ``radius`` [H, W] in px and ``depth`` [H, W], if they are at hand: in a file
            that is named, in a channel, or in a file beside one of both.
    """

    def __init__(
        self,
        evidence: Evidence,
        files: tuple[DecodedPicture, DecodedPicture],
        corner: tuple[int, int],
        coc: Path | None,
    ) -> None:
        (x, y), (height, width) = corner, evidence.size
        step = slice(None, None, max(1, math.ceil(math.sqrt(height * width / _LOOKED_AT))))
        self.evidence, self.cut = evidence, (step, step)
        self.sides = [evidence.scaled(evidence.at(side, *self.cut)) for side in "ab"]
        difference = (self.sides[1] - self.sides[0]).astype(np.float64)
        finite = evidence.pixels.finite
        self.power = (difference * np.abs(difference)).sum(axis=0)
        self.power *= True if finite is None else finite[self.cut]
        full, within = (
            (files[0].height, files[0].width),
            (slice(y, y + height), slice(x, x + width)),
        )
        self.maps: dict[str, Any] = {}
        for name, plane in ((n, p) for file in files for n, p in file.planes.items()):
            kind = "depth" if name in _DEPTHS else "radius" if name == "coc" else ""
            if kind and plane.shape == full:
                self.maps.setdefault(kind, np.nan_to_num(plane[within].astype(np.float32)))
        beside = [
            f.path.parent.parent / "coc" / f"{f.path.stem}.exr" for f in files if f.path.parent
        ]
        for path in beside if coc is None else [coc, *beside]:
            if "radius" not in self.maps and path.is_file():
                with suppress(InputError):
                    self.maps["radius"] = read_radius(path, full)[within]


def _by_scene(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """Where the radius or the depth says something of a place."""
    radius, depth, reaches = shown.maps.get("radius"), shown.maps.get("depth"), [_EDGE_REACH]
    if radius is not None:
        sharp = np.abs(radius[shown.cut]) <= _SHARP
        yield "in focus only", "", sharp, _ONLY
        yield "out of focus only", "", ~sharp, _ONLY
        jumps = beside_jumps(radius)
        reaches.append(math.ceil(float(np.abs(radius).max())))
    elif depth is not None:
        inverse = 1 / np.maximum(depth, 1e-9)
        low, high = np.quantile(inverse[shown.cut], (0.01, 0.99))
        jumps = beside_jumps(inverse, max(_JUMP * float(high - low), 1e-9))
    else:
        return
    for reach in reaches:
        yield "at silhouettes", f", within {reach} px", widened(jumps, reach)[shown.cut], _MOST


def _by_light(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """Where A is steep, whatever the depth is; where the brightest channel is bright, or dark."""
    if shown.evidence.pixels.color:
        steep = np.hypot(*np.gradient(shown.sides[0].mean(axis=0)))
        yield "at edges", "", widened(steep > np.quantile(steep, _STEEPEST), 1), _MOST
        light = np.maximum(*shown.sides).max(axis=0)
        bright = _BRIGHT if shown.evidence.gamma == 1.0 else _BRIGHT_ON_SCREEN
        yield "in highlights", "", light > bright, _MOST
        yield "in shadows", "", light < _DARK, _MOST


def _by_frame(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """The border, and the rectangle that holds most of the blocks that choose it."""
    size, step = shown.evidence.size, shown.cut[0].step
    for wide in _BORDERS:
        inner = np.zeros(size, bool)
        inner[wide:-wide, wide:-wide] = True
        yield "at the border", f", within {wide} px", ~inner[shown.cut], _MOST
    power = np.abs(shown.power) * blocks_in_turn(size)[shown.cut]
    if not power.any():
        return
    ends = []
    for axis in (0, 1):
        total = np.cumsum(power.sum(axis=1 - axis))
        first, last = np.searchsorted(total, (_TAILS * total[-1], (1 - _TAILS) * total[-1]))
        ends.append((int(first) * step, min((int(last) + 1) * step, size[axis])))
    (top, bottom), (left, right) = ends
    within = np.zeros(size, bool)
    within[top:bottom, left:right] = True
    how = f" of {right - left}x{bottom - top} at {left},{top}"
    yield "in one region", how, within[shown.cut], _MOST


def place_of(shown: LocatedPair) -> Finding | None:
    """The place that tells most of where the difference lies; None if none tells enough."""
    power = np.abs(shown.power)
    total = float(power.sum())
    if shown.evidence.is_small or total**2 < _FEWEST * float(np.square(power).sum()):
        return None
    measures = ~blocks_in_turn(shown.evidence.size)[shown.cut]
    told = []
    for name, how, mask, least in chain(_by_scene(shown), _by_light(shown), _by_frame(shown)):
        used = measures if name == "in one region" else np.ones(mask.shape, bool)
        every = float(power[used].sum())
        share = float(power[mask & used].sum()) / every if every else 0.0
        area = np.count_nonzero(mask & used) / np.count_nonzero(used)
        if share >= least and 0 < area < 1 and (tells := _entropy(share, area)) >= _TELLS:
            told.append((tells, name, how, share, area, mask))
    if not told:
        return None
    _, name, how, share, area, mask = max(told, key=lambda each: each[0])
    sign = float(shown.power[mask].sum()) / float(power[mask].sum())
    kind = "brighter" if sign > _ONE_SIGN else "darker" if sign < -_ONE_SIGN else ""
    words = f"{share:.0%} of the difference in {area:.1%} of the pixels"
    text = f"{name}{how}: {words}" + (f", {kind}" if kind else "")
    return Finding(name, text, {"share": round(share, 4), "area": round(area, 4), "kind": kind})


def _entropy(share: float, area: float) -> float:
    """The relative entropy of two shares, in nats."""
    ends = ((share, area), (1 - share, 1 - area))
    return sum(p * math.log(p / q) for p, q in ends if p > 0)
