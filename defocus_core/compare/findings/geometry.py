"""Causes that move pixels: shift, turn, scale, swaps of views, fields and tiles, crop."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    PART,
    Evidence,
    Explanation,
    blocks_in_turn,
    fitted_in_parts,
    steepness,
    summed_up,
    sums_of_parts,
)
from defocus_core.compare.findings.table import EXACT

_OF_PARTS = "another view or frame"
_Scale = Callable[[NDArray[Any]], NDArray[Any]]

_PEAKS = 3  # of each correlation that are tried
_EXPLAINED = 0.05  # left of a difference, below which no further move is looked for
_LEAST_PART = 0.02  # px of a move that is looked at
_MOST_ERODED, _TOWARDS = 5, 0.97  # px; left by less of it than there is
_SMALL_LEFT, _ALMOST_WHOLE = 0.35, 0.9  # of a difference, by a shift of less than so many px
_TILES = (16, 32, 64, 128, 256, 512)  # px; each twice the one before
_MOST_TILES = 1500  # that may have been exchanged
_SCALED_ALIKE = 0.2  # of a growth, by which those of channels differ
_CHOSEN, _STEPS = 1600, 6  # samples that choose a small move, and steps to it
_AROUND = 1e-4  # px by which kernels of interpolation are moved for their slope
_LEAST_APART = 3  # px of a copy from the picture: a nearer one is blur
_NEAR = 12  # px of the moves of parts that are tried one by one
_BY_CHANCE = 0.6  # greatest share that a move of parts leaves of what others leave
_ONE_MOVE = 0.45  # px by which moves of parts differ where all is one move, rounded


def other_file(evidence: Evidence) -> Iterator[Explanation]:
    """B is another file that lies beside A."""
    rows, columns = evidence.places
    for name, planes in evidence.others.items():
        if all(n in planes and planes[n].shape == evidence.size for n in evidence.names):
            there = np.stack([planes[n][rows, columns] for n in evidence.names])
            left = evidence.left(np.nan_to_num(there.astype(np.float32)))
            yield Explanation(left, name.partition(":")[0], text=name)


def flipped(evidence: Evidence) -> Iterator[Explanation]:
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


def cropped(evidence: Evidence) -> Iterator[Explanation]:
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


def tiles(evidence: Evidence) -> Iterator[Explanation]:
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
    return np.asarray(rows.reshape(*rows.shape[:-1], across, side).mean(axis=-1))


def _shifted(
    evidence: Evidence, dx: int, dy: int, places: tuple[Any, Any] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A moved by (dx, dy), [C, N], at the samples or other places, and where it was within."""
    (rows, columns), (height, width) = places or evidence.places, evidence.size
    y, x = rows - dy, columns - dx
    within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    return evidence.at("a", y.clip(0, height - 1), x.clip(0, width - 1)), within


@lru_cache(maxsize=1)
def _offsets_tried(evidence: Evidence) -> list[tuple[float, int, int]]:
    """What shifts by whole pixels leave, and these, the best first."""
    offsets = dict.fromkeys([(0, 0), *_offsets(evidence)])
    tried = [(evidence.left(*_shifted(evidence, *offset)), *offset) for offset in offsets]
    return sorted(tried, key=lambda each: (round(each[0], 2), abs(each[1]) + abs(each[2])))


def _offsets(evidence: Evidence, *, of_difference: bool = False) -> list[tuple[int, int]]:
    """Shifts (dx, dy) by which B, or its difference, is most like A where most differs."""
    a, b = (evidence.scaled(evidence.at(s, *evidence.frame)).mean(axis=0)[None] for s in "ab")
    found = _peaks(a, b - a if of_difference else b, _PEAKS)
    return list(dict.fromkeys(chain.from_iterable(peaks[0] for peaks in found)))


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


def moved(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by whole pixels or by parts of one, or turned, enlarged or sheared.

    What comes in at the border may be anything. In light, channels may also have been scaled about
    the middle by factors that differ.
    """
    least, dx, dy = _offsets_tried(evidence)[0]
    if (dx, dy) != (0, 0) and least <= EXACT:
        yield Explanation(least, "shifted", f" by ({dx}, {dy})", {"dx": dx, "dy": dy})
    if least <= _EXPLAINED or min(evidence.size) <= 16:
        return
    first = tuple(sorted(evidence.names, key=lambda name: name[-1:] not in "GY")[:1])
    of_parts, starts = _parts(evidence), [np.array([dy, 0, 0, dx, 0, 0, 0], "f8")]
    if of_parts is not None and np.ptp(of_parts.moves, axis=0).max() >= 1:
        starts.append(of_parts.common)
    for move in starts:
        for free in (_SHIFT, _SIMILAR, _AFFINE, _LENS):
            move, better = _fitted(evidence, first, move, free)
            if not better:
                continue
            inside, (there,) = _moved(evidence, *evidence.places, move, evidence.names)
            left = evidence.left(_interpolated(evidence)[1](there), inside)
            cost = 0.01 * len(free) - 0.01 + 0.03 * (free is _LENS)
            name, text, values = _moved_words(move, _far(evidence))
            if name == "shifted" and left > EXACT and np.abs(move).max() > _ALMOST_WHOLE:
                name = _OF_PARTS
                text = f"{name}: most moved by ({move[3]:.2f}, {move[0]:.2f}) px"
            if name != "shifted" or left <= _SMALL_LEFT:
                yield Explanation(left, name, values=values, cost=cost, text=text)
            least = min(least, left)
            if least <= _EXPLAINED:
                return
        if least <= EXACT:
            return
    yield from _chromatic(evidence)


def _chromatic(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of B are those of A, scaled about the middle by factors that differ."""
    names = [name for layer in evidence.pixels.color for name in layer if name in evidence.names]
    if len(names) < 2 or names != [*evidence.names]:
        return
    growths, predicted, within = {}, [], np.ones(evidence.places[0].shape, bool)
    for name in names:
        move, _ = _fitted(evidence, (name,), np.zeros(7), _GROWTH)
        inside, (there,) = _moved(evidence, *evidence.places, move, (name,))
        predicted.append(_interpolated(evidence)[1](there)[0])
        growths[name], within = 1 + move[1] / _far(evidence), within & inside
    factors = [*growths.values(), *([1.0] if len(names) < 3 else [])]
    alike = _SCALED_ALIKE * max(abs(factor - 1) for factor in factors)
    if np.ptp(factors) > max(5 * _LEAST_PART / _far(evidence), alike):
        said = ", ".join(f"{name} scaled by {scale:.5g}" for name, scale in growths.items())
        left = evidence.left(np.stack(predicted), within)
        yield Explanation(left, "chromatic aberration", f": {said}", {"scales": growths}, 0.05)


def _far(evidence: Evidence) -> float:
    """Distance from the middle, in px, at which turn, growth and shear are measured."""
    return max(evidence.size) / 2


# Of a move: how far down and how far right, in px: in the middle, and more by the row and by the
# column at `_far`; and how far out at `_far`, by the cube of the distance, as lenses distort. Each
# free parameter is a row.
_AFFINE, _DISTORTION = np.split(np.eye(7), [6])
_SHIFT, _GROWTH = _AFFINE[[0, 3]], _AFFINE[[1]] + _AFFINE[[5]]
_SIMILAR = np.concatenate([_SHIFT, _GROWTH, _AFFINE[[4]] - _AFFINE[[2]]])
_LENS = np.concatenate([_SIMILAR, _DISTORTION])


def _fitted(
    evidence: Evidence, names: tuple[str, ...], start: NDArray[Any], free: NDArray[Any]
) -> tuple[NDArray[np.float64], bool]:
    """The move near another that makes B of A, and whether it explains some of it, or the other.

    It is found by least squares on the gradient (Lucas and Kanade, 1981).
    """
    rows, columns = evidence.places
    fits = np.flatnonzero(evidence.fits)
    fits = fits[:: max(1, len(fits) // _CHOSEN)]
    places = rows[fits], columns[fits]
    far, (height, width) = _far(evidence), evidence.size
    y, x = (places[0] - (height - 1) / 2) / far, (places[1] - (width - 1) / 2) / far
    scale, _ = _interpolated(evidence)
    was, aim = (scale(evidence.at(side, *places, names)) for side in "ab")
    # Light counts as much as a screen shows of it.
    slope = steepness(was) if scale == evidence.light else 1.0
    move, rest, ways = start.copy(), aim - was, [aim]
    for _ in range(_STEPS):
        inside, (there, down, right) = _moved(evidence, *places, move, names, sloped=True)
        out = (y * y + x * x) * (down * y + right * x)
        ways = [
            -v * slope * inside
            for v in (down, down * y, down * x, right, right * y, right * x, out)
        ]
        rest = (aim - there) * slope * inside
        design = free @ np.stack([way.ravel() for way in ways])
        step = np.linalg.lstsq(design @ design.T, design @ rest.ravel(), rcond=None)[0].clip(-2, 2)
        move += step @ free
        if np.abs(step).max() < 0.002:
            break
    every = np.square((aim - was) * slope * inside).sum()
    better = np.isfinite(move).all() and np.abs(move).max() >= _LEAST_PART
    better = better and np.square(rest).sum() <= 0.5 * every
    return (move, True) if better else (start, False)


def _interpolated(evidence: Evidence) -> tuple[_Scale, _Scale]:
    """The scale that values are interpolated on, and back: light of EXR, and else as stored."""
    if evidence.gamma == 1.0 and evidence.pixels.color:
        return evidence.light, evidence.stored
    return evidence.scaled, evidence.unscaled


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
    names: Sequence[str],
    *,
    sloped: bool = False,
) -> tuple[NDArray[np.bool_], list[NDArray[Any]]]:
    """Places of A that were within it, and A there, if asked for with its slopes down and right."""
    far, (height, width) = _far(evidence), evidence.size
    y, x = (rows - (height - 1) / 2) / far, (columns - (width - 1) / 2) / far
    out = move[6] * (y * y + x * x)
    at_y = rows - move[0] - move[1] * y - move[2] * x - out * y
    at_x = columns - move[3] - move[4] * y - move[5] * x - out * x
    inside = (at_y > 2) & (at_y < height - 3) & (at_x > 2) & (at_x < width - 3)
    top, left = np.floor(at_y).astype(np.intp), np.floor(at_x).astype(np.intp)
    taps = np.arange(-1, 3)[:, None]
    lines, row = (top + taps).clip(0, height - 1)[:, None], (left + taps).clip(0, width - 1)
    values = _interpolated(evidence)[0](evidence.at("a", lines, row, names))  # [C, 4, 4, N]
    down, across = at_y - top - taps, at_x - left - taps
    ways = [(keys(down), keys(across))]
    if sloped:
        slopes = [(keys(t + _AROUND) - keys(t - _AROUND)) / (2 * _AROUND) for t in (down, across)]
        ways += [(slopes[0], ways[0][1]), (ways[0][0], slopes[1])]
    return inside, [np.einsum("kn,jn,ckjn->cn", k, j, values) for k, j in ways]


def _moved_words(move: NDArray[Any], far: float) -> tuple[str, str, dict[str, float]]:
    """The name, words and numbers of a small move; what moves most gives the name."""
    dy, grows_down, turns_down, dx, turns, grows, out = (float(v) for v in move)
    turn, growth = (turns - turns_down) / 2, (grows_down + grows) / 2
    shear = math.hypot(turns + turns_down, grows - grows_down) / 2
    degrees, scale = float(np.degrees(turn / far)), 1 + growth / far
    values = {"dx": dx, "dy": dy, "degrees": degrees, "scale": scale, "shear": shear}
    ways = [f"shifted by ({dx:.2f}, {dy:.2f})"] * bool(np.hypot(dx, dy) > _LEAST_PART)
    ways += [f"rotated by {degrees:.3g}° to the left"] * (abs(turn) > 0.1)
    ways += [f"scaled by {scale:.5g}"] * (abs(growth) > 0.1 and not out)
    ways += [f"scaled by {scale:.5g}, at the sides by {scale + out / far:.5g}"] * bool(out)
    ways += [f"sheared by {2 * shear:.3g} px"] * (shear > 0.1)
    sizes = {"shifted": np.hypot(dx, dy), "rotated": abs(turn), "scaled": abs(growth) + abs(out)}
    strongest = max(sizes, key=lambda name: sizes[name])
    if shear > 0.4 * sizes[strongest]:  # a shear of one axis is half a turn
        strongest = "sheared"
    ways.sort(key=lambda way: not way.startswith(strongest))
    return strongest, " and ".join(ways) or strongest, values


@dataclass(frozen=True)
class _Parts:
    """Parts of the frame, each moved by whole pixels and a fraction."""

    predicted: NDArray[Any]  # light of the frame as a screen shows it, [h, w]
    moves: NDArray[Any]  # (dx, dy) of each part that matters, [n, 2]
    common: NDArray[np.float64]  # the move of all, of 7 parameters, that is nearest to them
    apart: float  # RMS distance in px of the moves from it


@lru_cache(maxsize=1)
def _parts(evidence: Evidence) -> _Parts | None:
    """The moves of parts of the frame; None where it has too few."""
    if min(evidence.size) < 3 * PART:
        return None
    a, b = (evidence.scaled_light(side).astype(np.float64) for side in evidence.framed)
    known = [(dx, dy) for _, dx, dy in _offsets_tried(evidence)]
    candidates = list(dict.fromkeys([(0, 0), *_part_offsets(a, b), *known]))
    chooses = blocks_in_turn(a.shape, 4)
    pictures = [np.roll(a, (dy, dx), (0, 1)) for dx, dy in candidates]
    costs = [sums_of_parts(np.abs(there - b) * chooses) for there in pictures]
    order = np.argsort(np.stack(costs), axis=0, kind="stable")[0]
    chosen = np.repeat(np.repeat(order, PART, axis=0), PART, axis=1)[: a.shape[0], : a.shape[1]]
    predicted = np.take_along_axis(np.stack(pictures), chosen[None], axis=0)[0]
    # What moves by fractions of a pixel add, by least squares on the gradient.
    predicted = predicted + fitted_in_parts(np.gradient(predicted), b - predicted, chooses)
    energy = sums_of_parts(np.square(b - a))
    matter = energy > np.quantile(energy, 0.5)
    if not matter.any():
        return None
    moves = np.array(candidates, dtype="f8")[order][matter]
    # The move of all, by the energy of the parts.
    rows, columns = (PART * (v + 0.5) for v in np.nonzero(matter))
    y, x = (
        (v + cut.start - (n - 1) / 2) / _far(evidence)
        for v, cut, n in zip((rows, columns), evidence.frame, evidence.size, strict=True)
    )
    root = np.sqrt(energy[matter])[:, None]
    design = np.stack([np.ones(len(y)), y, x], axis=1)
    solved = np.linalg.lstsq(design * root, moves * root, rcond=None)[0]
    rest = np.square((moves - design @ solved) * root).sum() / max(float((root**2).sum()), 1e-300)
    common = np.concatenate([solved[:, 1], solved[:, 0], [0.0]])
    return _Parts(predicted, moves, common, math.sqrt(float(rest)))


def moved_in_parts(evidence: Evidence) -> Iterator[Explanation]:
    """Parts of the picture have moved by different amounts: another view, or another frame."""
    if _offsets_tried(evidence)[0][0] <= _EXPLAINED:
        return
    parts = _parts(evidence)
    if parts is None or parts.apart < _ONE_MOVE:
        return
    (x0, y0), (x1, y1) = (choose(parts.moves, axis=0) for choose in (np.min, np.max))
    how = f": parts moved by {x0:.0f} to {x1:.0f} px across, {y0:.0f} to {y1:.0f} px down"
    chooses = blocks_in_turn(parts.predicted.shape, 4)
    left = evidence.left_framed(evidence.unscaled_light(parts.predicted), ~chooses)
    cost = 0.0 if parts.apart > 1 else 0.1
    yield Explanation(left, _OF_PARTS, how, cost=cost)


def displaced(evidence: Evidence) -> Iterator[Explanation]:
    """Light of B is that of A and that of A moved: added up, or the one or the other in places."""
    a, b = evidence.sampled
    light, aim = evidence.light(a), evidence.light(b)
    slope = steepness(light) * evidence.fits * evidence.steady
    shown, shown_aim = evidence.scaled(a), evidence.scaled(b)

    def left_in_places(dx: int, dy: int) -> float:
        """What is left if each pixel is that of A or of A moved, whichever is nearer."""
        there, within = _shifted(evidence, dx, dy)
        apart = (
            np.square(side - shown_aim).sum(axis=0) for side in (evidence.scaled(there), shown)
        )
        return evidence.left(np.where(within & np.less(*apart), there, a), exact=True)

    offsets = _offsets(evidence, of_difference=True)
    peaks = [peak for peak in offsets if math.hypot(*peak) >= _LEAST_APART]
    for dx, dy in peaks:
        there, within = _shifted(evidence, dx, dy)
        copy = evidence.light(there)
        one, other = summed_up([light, copy], aim - light, slope * within)
        predicted = light * (1 + one) + copy * other
        used = within & evidence.steady.all(axis=0)
        left = evidence.left(evidence.stored(predicted), used)
        share = float(other / max(1 + one + other, 1e-9))
        if 0 < share <= 0.5:
            how = f": {share:.2g} of its light is a copy moved by ({dx}, {dy}) px"
            values = {"share": share, "dx": dx, "dy": dy}
            yield Explanation(left, "doubled", how, values, 0.01)
    for dx, dy in (_nearest_move(evidence), *peaks[:3]):
        left = left_in_places(dx, dy)
        others = ((-dx, -dy), (dy, -dx), (-dy, dx))
        if left < 0.5 and left < _BY_CHANCE * min(left_in_places(*other) for other in others):
            how, values = f": parts moved by ({dx}, {dy}) px", {"dx": dx, "dy": dy}
            yield Explanation(left, _OF_PARTS, how, values, 0.02)


def _nearest_move(evidence: Evidence) -> tuple[int, int]:
    """The move (dx, dy) of a few px by which pixels that differ are most like one of A or of it."""
    rows, columns = evidence.places
    chosen = np.flatnonzero(evidence.fits & (evidence.pixels.greatest[rows, columns] > 0))
    places = rows[chosen[: _CHOSEN // 2]], columns[chosen[: _CHOSEN // 2]]
    a, b = (evidence.scaled(evidence.at(side, *places)) for side in "ab")
    before = np.abs(b - a).sum(axis=0)

    def cost(move: tuple[int, int]) -> float:
        there = evidence.scaled(_shifted(evidence, *move, places)[0])
        return float(np.minimum(before, np.abs(there - b).sum(axis=0)).sum())

    return min(((dx, dy) for dy, dx in product(range(-_NEAR, _NEAR + 1), repeat=2)), key=cost)


def eroded(evidence: Evidence) -> Iterator[Explanation]:
    """Each pixel of B is the least, or the greatest, of those of A around it, as of alpha."""
    a, b = evidence.sampled
    signs = np.sign(b - a)
    if (signs < 0).any() == (signs > 0).any():
        return
    name, choose = ("eroded", np.minimum) if (signs < 0).any() else ("dilated", np.maximum)
    for of in ("square", "disc"):
        predicted = a.copy()
        for reach in range(1, _MOST_ERODED + 1):
            for dy, dx in product(range(-reach, reach + 1), repeat=2):
                if of == "square" or dy * dy + dx * dx <= reach * reach:
                    predicted = choose(predicted, _shifted(evidence, dx, dy)[0])
            left = evidence.left(predicted, exact=True)
            if left > _TOWARDS:
                break
            yield Explanation(left, name, f" by {reach} px", {"px": reach}, -0.02)


def _part_offsets(a: NDArray[Any], b: NDArray[Any]) -> list[tuple[int, int]]:
    """Moves (dx, dy) of windows of twice the size of a part, the most frequent first."""
    side = 2 * PART
    corners = product(*(range(0, max(n - side, 0) + 1, PART) for n in a.shape))
    cuts = [(slice(y, y + side), slice(x, x + side)) for y, x in corners]
    old, new = (np.stack([values[cut] for cut in cuts]) for values in (a, b))
    found = Counter(peak for each in _peaks(old, new, 1) for (peak,) in each)
    near = Counter({(x + dx, y): 0.3 for x, y in list(found) for dx in (-1, 1)})
    return [offset for offset, _ in (found + near).most_common(24)]
