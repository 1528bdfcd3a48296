"""Explanations that move pixels: shift, turn, scale, swaps of views, fields and tiles, crop."""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.evidence import Evidence, Explanation, blocks_in_turn
from defocus_core.compare.findings.finding import Finding

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    _Scale = Callable[[NDArray[Any]], NDArray[Any]]

_FRAME = 1024  # px of the middle of a picture in which a shift is looked for
_PEAKS = 3  # of each correlation that are tried
_LARGEST_PART = 0.05  # px of a shift that are no fraction
_SHIFT_LEFT = 0.15  # of a difference that a shift may leave: parts of another frame move alike
_MOVE_LEFT = 0.4  # the same of a turn or of another scale
_PARTS_LEFT = 0.62  # of a difference that parts which move on their own may leave
_TILES = (16, 32, 64, 128, 256, 512)  # px; each twice the one before
_MOST_TILES = 1500  # that may have been exchanged
_CHOSEN = 5000  # samples that choose a small move
_ONE_MOVE = 0.45  # px by which moves of parts differ where all is one move, rounded
_PART = 32  # px of the parts that may move on their own
_VIEW = re.compile(r"(?<![A-Za-z])(left|right|L|R|l|r)(?![A-Za-z])", re.I)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
_FRAME_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def explanations(
    evidence: Evidence, others: Mapping[str, Mapping[str, NDArray[Any]]]
) -> Iterator[Explanation]:
    """All that might be, the simplest first.

    Args:
        evidence: the pair.
        others: channels of files beside that of A, by the finding that B is one of these.
    """
    rows, columns = evidence.places
    for name, planes in others.items():
        if all(n in planes and planes[n].shape == evidence.size for n in evidence.names):
            yield _other_file(evidence, name, planes)
    height, width = evidence.size
    moves = {
        "flipped left to right": (rows, width - 1 - columns),
        "flipped upside down": (height - 1 - rows, columns),
        "rotated by 180°": (height - 1 - rows, width - 1 - columns),
        "fields exchanged: even and odd rows": ((rows ^ 1).clip(0, height - 1), columns),
    }
    if height == width:
        moves |= {
            "rotated by 90° to the left": (columns, width - 1 - rows),
            "rotated by 90° to the right": (height - 1 - columns, rows),
            "flipped over its diagonal": (columns, rows),
        }
    if width % 2 == 0:
        moves["left and right swapped: the halves of the picture"] = (
            rows,
            (columns + width // 2) % width,
        )
    names = ("fields exchanged", "left and right swapped")
    for text, (y, x) in moves.items():
        name = next((n for n in names if text.startswith(n)), text.split()[0])
        yield Explanation(Finding(name, text), evidence.left(evidence.at("a", y, x)))
    yield from _cropped(evidence)
    yield from _tiles_exchanged(evidence)
    yield from _shifted(evidence)


def partners(path: Path | None) -> Iterator[tuple[str, Path]]:
    """Files that may stand in for another, with the finding that one does.

    These are the other of the left and right view, the views of a render and the reverse, and the
    frames before and after it.
    """
    if path is None:
        return
    view = view_partner(path)
    if view is not None:
        yield "left and right swapped", view
    kinds = ("render", "left", "right")
    if path.parent.name in kinds:
        for kind in kinds:
            other = path.parent.with_name(kind) / path.name
            if kind != path.parent.name and other != view and other.is_file():
                yield f"another view or frame: {kind} in place of {path.parent.name}", other
    match = _FRAME_NUMBER.search(path.stem)
    if match is None:
        return
    for step in (-1, 1):
        number = f"{int(match[1]) + step:0{len(match[1])}d}"
        other = path.with_name(
            path.stem[: match.start()] + number + path.stem[match.end() :] + path.suffix
        )
        if other.is_file():
            yield f"another view or frame: that of {other.name}", other


def view_partner(path: Path) -> Path | None:
    """The file of the other of the left and right view, by its name; None if there is none.

    The last of file name and folder that names a view decides.
    """
    for place in (path.stem, path.parent.name):
        match = list(_VIEW.finditer(place))
        if not match:
            continue
        word = match[-1][0]
        other = _OTHER[word.lower()]
        other = other.upper() if word.isupper() else other
        other = other.capitalize() if word.istitle() and len(word) > 1 else other
        renamed = place[: match[-1].start()] + other + place[match[-1].end() :]
        partner = (
            path.with_name(renamed + path.suffix)
            if place == path.stem
            else path.parent.with_name(renamed) / path.name
        )
        if partner.is_file():
            return partner
    return None


def _other_file(evidence: Evidence, name: str, planes: Mapping[str, NDArray[Any]]) -> Explanation:
    rows, columns = evidence.places
    predicted = np.stack([planes[n][rows, columns] for n in evidence.names]).astype(np.float32)
    return Explanation(
        Finding(name.partition(":")[0], name), evidence.left(np.nan_to_num(predicted))
    )


def _cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside of a window, and as A within it."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    if all(plane[0].any() and plane[:, 0].any() and plane[-1].any() for plane in planes):
        return
    kept = np.logical_or.reduce([plane != 0 for plane in planes])
    if not kept.any():
        return
    (top, bottom), (left, right) = (
        (int(np.flatnonzero(kept.any(axis=axis))[0]), int(np.flatnonzero(kept.any(axis=axis))[-1]))
        for axis in (1, 0)
    )
    if (bottom - top + 1, right - left + 1) == evidence.size:
        return
    rows, columns = evidence.places
    inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
    a, _ = evidence.sampled
    window = [left, top, right - left + 1, bottom - top + 1]
    text = f"a crop: 0 outside of {window[2]}x{window[3]} at {left},{top}"
    finding = Finding("crop", text, {"window": window})
    yield Explanation(finding, evidence.left(np.where(inside, a, np.float32(0.0))))


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
        finding = Finding("tiles exchanged", f"tiles exchanged: of {side} px", {"side": side})
        if step.any():
            yield Explanation(finding, evidence.left(predicted), cost=0.001 * _TILES.index(side))


def _means(planes: NDArray[Any], side: int) -> NDArray[np.float32]:
    """Means of the whole tiles of planes [..., H, W]."""
    down, across = (length // side for length in planes.shape[-2:])
    cut = planes[..., : down * side, : across * side]
    blocks = cut.reshape(*planes.shape[:-2], down, side, across, side)
    means: NDArray[np.float32] = blocks.mean(axis=(-3, -1), dtype=np.float32)
    return means


def _shifted(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved, turned or enlarged; what comes in at the border may be anything."""
    rows, columns = evidence.places
    height, width = evidence.size
    tried: list[tuple[float, int, int]] = []
    for dx, dy in _offsets(evidence):
        y, x = rows - dy, columns - dx
        within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        predicted = evidence.at("a", y.clip(0, height - 1), x.clip(0, width - 1))
        tried.append((evidence.left(predicted, within), dx, dy))
    tried.sort(key=lambda each: (round(each[0], 2), abs(each[1]) + abs(each[2])))
    left, dx, dy = tried[0]
    if (dx, dy) != (0, 0):
        values = {"dx": dx, "dy": dy}
        finding = Finding("shifted", f"shifted by ({dx}, {dy})", values)
        yield Explanation(finding, left, _SHIFT_LEFT)
    if left > _LARGEST_PART and min(evidence.size) > 16:
        yield from _moved_a_little(evidence, dx, dy)
        if min(evidence.size) >= 3 * _PART:
            yield from _moved_in_parts(evidence, tried)


def _offsets(evidence: Evidence) -> list[tuple[int, int]]:
    """Shifts (dx, dy) worth trying: peaks of correlations, and small ones."""
    a, b = (_middle(evidence, side) for side in ("a", "b"))
    height, width = a.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[None, 1:-1]
    a, b = ((side - side.mean()) * window for side in (a, b))
    spectrum = np.conj(np.fft.rfft2(a)) * np.fft.rfft2(b)
    magnitude = np.abs(spectrum) + 1e-12 * float(np.abs(spectrum).max(initial=0.0)) + 1e-300
    offsets = [*product((-1, 0, 1), (-1, 0, 1))]
    for whitening in (1.0, 0.5):
        correlation = np.fft.irfft2(spectrum / magnitude**whitening, s=a.shape)
        flat = correlation.ravel()
        count = min(_PEAKS, flat.size)
        for place in np.argpartition(flat, -count)[-count:]:
            dy, dx = divmod(int(place), width)
            offsets.append((dx - width * (dx > width // 2), dy - height * (dy > height // 2)))
    return list(dict.fromkeys(offsets))


def _middle(evidence: Evidence, side: str) -> NDArray[Any]:
    """The mean of the channels in the middle of a picture, on the scale of differences."""
    height, width = evidence.size
    high, wide = min(height, _FRAME), min(width, _FRAME)
    top, left = (height - high) // 2, (width - wide) // 2
    cut = (slice(top, top + high), slice(left, left + wide))
    middle: NDArray[Any] = evidence.scaled(evidence.at(side, *cut)).mean(axis=0, dtype="f8")
    return middle


def _moved_a_little(evidence: Evidence, dx: int, dy: int) -> Iterator[Explanation]:
    """B is A moved by fractions, turned or enlarged around the middle, with cubic interpolation.

    Shift, angle and scale are found by least squares on the gradient (Lucas and Kanade, 1981).
    """
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
        if not np.isfinite(move).all() or np.abs(move).max() < _LARGEST_PART:
            continue
        if np.square(rest).sum() > 0.5 * np.square((aim - was)[:, inside]).sum():
            continue
        left = _left_by_move(evidence, move, far)
        finding = _moved_words(move, far)
        limit = _SHIFT_LEFT if finding.name == "shifted" else _MOVE_LEFT
        yield Explanation(finding, left, limit, 0.01 + 0.02 * (free - 2))


def _left_by_move(evidence: Evidence, move: NDArray[Any], far: float) -> float:
    """What a move leaves: light may have been interpolated as such, or as a screen shows it."""
    scales: list[tuple[_Scale, _Scale]] = [(evidence.scaled, evidence.unscaled)]
    if evidence.pixels.color:
        scales.append((evidence.light, evidence.stored))
    lefts = []
    for scale, back in scales:
        inside, sums = _moved(evidence, *evidence.places, move, far, evidence.names, scale)
        lefts.append(evidence.left(back(sums[0]), inside))
    return min(lefts)


def _moved(
    evidence: Evidence,
    rows: NDArray[Any],
    columns: NDArray[Any],
    move: NDArray[Any],
    far: float,
    names: Sequence[str],
    scale: _Scale | None = None,
) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Places of A that were within it, and A there with its slopes down and right, [3, C, N].

    Values are on the scale of differences, or another; between pixels they are cubic (Keys, -1/2).
    """
    scale = scale or evidence.scaled
    height, width = evidence.size
    y, x = rows - (height - 1) / 2, columns - (width - 1) / 2
    at_y = rows - move[0] - (move[3] * y + move[2] * x) / far
    at_x = columns - move[1] - (move[3] * x - move[2] * y) / far
    inside = (at_y > 2) & (at_y < height - 3) & (at_x > 2) & (at_x < width - 3)
    top, left = np.floor(at_y).astype(np.intp), np.floor(at_x).astype(np.intp)
    (down, slope_down), (across, slope_across) = _keys(at_y - top), _keys(at_x - left)
    total = np.zeros((3, len(names), len(rows)))
    for k in range(4):
        for j in range(4):
            line, column = (top + k - 1).clip(0, height - 1), (left + j - 1).clip(0, width - 1)
            value = scale(evidence.at("a", line, column, names))
            weights = down[k] * across[j], slope_down[k] * across[j], down[k] * slope_across[j]
            for sums, weight in zip(total, weights, strict=True):
                sums += weight * value
    return inside, total


def _moved_words(move: NDArray[Any], far: float) -> Finding:
    """The finding of a small move: what of shift, turn and scale moves most is its name."""
    dy, dx, turn, growth = (float(v) for v in move)
    degrees, scale = float(np.degrees(turn / far)), 1 + growth / far
    values = {"dx": dx, "dy": dy, "degrees": degrees, "scale": scale}
    ways = [f"shifted by ({dx:.2f}, {dy:.2f})"] * bool(np.hypot(dx, dy) > _LARGEST_PART)
    ways += [f"rotated by {-degrees:.3g}° to the left"] * (abs(turn) > 0.1)
    ways += [f"scaled by {scale:.5g}"] * (abs(growth) > 0.1)
    strongest = max((np.hypot(dx, dy), "shifted"), (abs(turn), "rotated"), (abs(growth), "scaled"))
    ways.sort(key=lambda way: not way.startswith(strongest[1]))
    return Finding(strongest[1], " and ".join(ways), values)


def _keys(t: NDArray[Any]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Weights of the four pixels around a place, and their derivatives."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ), (
        (-1.5 * t + 2.0) * t - 0.5,
        (4.5 * t - 5.0) * t,
        (-4.5 * t + 4.0) * t + 0.5,
        (1.5 * t - 1.0) * t,
    )


def _moved_in_parts(
    evidence: Evidence, tried: list[tuple[float, int, int]]
) -> Iterator[Explanation]:
    """Parts of the picture have moved by different amounts: another view, or another frame."""
    a, b = (evidence.scaled_light(side).astype(np.float64) for side in evidence.framed)
    candidates = list(
        dict.fromkeys([(0, 0), *_part_offsets(a, b), *((dx, dy) for _, dx, dy in tried)])
    )
    chooses = blocks_in_turn(a.shape, 4)
    costs, moved = [], []
    for dx, dy in candidates:
        there = _moved_by(a, dx, dy)
        costs.append(_sums_of_parts(np.abs(there - b) * chooses))
        moved.append(there)
    order = np.argsort(np.stack(costs), axis=0, kind="stable")[0]
    chosen = np.repeat(np.repeat(order, _PART, axis=0), _PART, axis=1)[: a.shape[0], : a.shape[1]]
    predicted = np.take_along_axis(np.stack(moved), chosen[None], axis=0)[0]
    predicted = predicted + _rest_of_move(predicted, b, chooses)
    energy = _sums_of_parts(np.square(b - a))
    moves = np.array(candidates, dtype="f8")[order]  # [h, w, 2]
    matter = energy > np.quantile(energy, 0.5)
    apart = _apart_from_one_move(moves, energy * matter)
    if apart < _ONE_MOVE or not matter.any():
        return
    (x0, y0), (x1, y1) = (choose(moves[matter], axis=0) for choose in (np.min, np.max))
    span = f"{x0:.0f} to {x1:.0f} px across, {y0:.0f} to {y1:.0f} px down"
    finding = Finding("another view or frame", f"another view or frame: parts moved by {span}")
    left = evidence.left_framed(evidence.unscaled_light(predicted), ~chooses)
    yield Explanation(finding, left, _PARTS_LEFT, 0.0 if apart > 1 else 0.1)


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
    side = 2 * _PART
    tops, lefts = (range(0, max(n - side, 0) + 1, _PART) for n in a.shape)
    window = np.hanning(side + 2)[1:-1, None] * np.hanning(side + 2)[None, 1:-1]
    corners = list(product(tops, lefts))
    old, new = (
        np.stack([side_[y : y + side, x : x + side] for y, x in corners]) for side_ in (a, b)
    )
    old, new = (np.fft.rfft2((v - v.mean(axis=(1, 2), keepdims=True)) * window) for v in (old, new))
    spectrum = np.conj(old) * new
    found: Counter[tuple[int, int]] = Counter()
    for whitening in (1.0, 0.5):
        magnitude = np.abs(spectrum) + 1e-9 * np.abs(spectrum).max() + 1e-300
        peaks = np.fft.irfft2(spectrum / magnitude**whitening, s=(side, side)).reshape(
            len(corners), -1
        )
        for place in peaks.argmax(axis=1):
            dy, dx = divmod(int(place), side)
            found[dx - side * (dx > side // 2), dy - side * (dy > side // 2)] += 1
    near = Counter({(x + dx, y): 0.3 for x, y in list(found) for dx in (-1, 1)})
    return [offset for offset, _ in (found + near).most_common(24)]


def _moved_by(values: NDArray[Any], dx: int, dy: int) -> NDArray[Any]:
    """Values [h, w] moved to the right and down; the border is repeated."""
    rows, columns = (
        (np.arange(n) - step).clip(0, n - 1) for n, step in zip(values.shape, (dy, dx), strict=True)
    )
    moved: NDArray[Any] = values[rows][:, columns]
    return moved


def _sums_of_parts(values: NDArray[Any], side: int = _PART) -> NDArray[Any]:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def _rest_of_move(a: NDArray[Any], b: NDArray[Any], chooses: NDArray[np.bool_]) -> NDArray[Any]:
    """What a move of each part by fractions of a pixel adds, by least squares on the gradient."""
    slopes: Any = np.gradient(a)
    return fitted_in_parts(slopes, b - a, chooses)


def fitted_in_parts(
    columns: Sequence[NDArray[Any]],
    aim: NDArray[Any],
    chooses: NDArray[np.bool_],
    side: int = _PART,
) -> NDArray[Any]:
    """The sum [h, w] of multiples of columns [h, w] that each part of a picture has for itself.

    The multiples are those of least squares at the pixels that choose, with a little of a ridge.
    """
    square = np.stack(
        [[_sums_of_parts(one * other * chooses, side) for other in columns] for one in columns]
    )
    sums = np.stack([_sums_of_parts(one * aim * chooses, side) for one in columns])
    square, sums = np.moveaxis(square, (0, 1), (-2, -1)), np.moveaxis(sums, 0, -1)
    scale = np.trace(square, axis1=-2, axis2=-1)
    ridge = (1e-3 * scale + 1e-3 * scale.mean() + 1e-30)[..., None, None]
    solved = np.linalg.solve(square + ridge * np.eye(len(columns)), sums[..., None])[..., 0]
    total = np.zeros_like(aim)
    height, width = aim.shape
    for k, column in enumerate(columns):
        each = np.repeat(np.repeat(solved[..., k], side, axis=0), side, axis=1)
        total += each[:height, :width] * column
    return total


def resized(a: Mapping[str, NDArray[Any]], b: Mapping[str, NDArray[Any]]) -> Iterator[Finding]:
    """How a picture of another size comes from A: as a crop of it, or turned by 90°.

    Args:
        a: channels [H, W] by name.
        b: channels [h, w] by name, all of one size.
    """
    names = [name for name in a if name in b]
    if not names:
        return
    old, new = (np.stack([np.nan_to_num(side[name]) for name in names]) for side in (a, b))
    if old.shape[1:] == new.shape[:0:-1]:
        turned = {
            "to the left": np.rot90(old, 1, (1, 2)),
            "to the right": np.rot90(old, -1, (1, 2)),
        }
        for side, planes in turned.items():
            if np.array_equal(planes, new):
                yield Finding("rotated", f"rotated by 90° {side}")
    large, small = (old, new) if old.shape[1] >= new.shape[1] else (new, old)
    (height, width), (high, wide) = large.shape[1:], small.shape[1:]
    if (high, wide) == (height, width) or high > height or wide > width:
        return
    for x, y in _corners(large, small):
        if np.array_equal(large[:, y : y + high, x : x + wide], small):
            whole = f"{width}x{height}"
            text = f"a crop: {wide}x{high} at {x},{y} of {whole}"
            if large is new:
                text = f"A is a crop of B: {wide}x{high} at {x},{y} of {whole}"
            yield Finding("crop", text, {"window": [x, y, wide, high]})
            return


def _corners(large: NDArray[Any], small: NDArray[Any]) -> Iterator[tuple[int, int]]:
    """Where a smaller picture may lie in a larger one: in the middle, at corners, at a match."""
    spare_y, spare_x = large.shape[1] - small.shape[1], large.shape[2] - small.shape[2]
    yield from product((spare_x // 2, 0, spare_x), (spare_y // 2, 0, spare_y))
    # Pixels that match one distinctive pixel of the smaller picture.
    flat = small.reshape(len(small), -1)
    for place in {int(flat[0].argmax()), int(flat[0].argmin()), flat.shape[1] // 2}:
        row, column = np.unravel_index(place, small.shape[1:])
        same = np.ones(large.shape[1:], bool)
        for plane, value in zip(large, flat[:, place], strict=True):
            same &= plane == value
        for y, x in np.argwhere(same)[:64]:
            corner = int(x - column), int(y - row)
            if 0 <= corner[0] <= spare_x and 0 <= corner[1] <= spare_y:
                yield corner
