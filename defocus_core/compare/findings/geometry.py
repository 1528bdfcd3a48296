"""Explanations that move pixels: shift, flip, rotation, swapped views, crop."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, compressed
from defocus_core.compare.findings.finding import Finding

_FRAME = 1024  # px of the middle of a picture in which a shift is looked for
_PEAKS = 3  # of each correlation that are tried
_LARGEST_PART = 0.05  # px of a shift that are no fraction
_PART_LEFT = 0.35  # of a difference that a shift by a fraction of a pixel may leave
_VIEW = re.compile(r"(?<![A-Za-z])(left|right|L|R|l|r)(?![A-Za-z])", re.I)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}


def explanations(
    evidence: Evidence, other_view: Mapping[str, NDArray[Any]] | None = None
) -> Iterator[Explanation]:
    """All that might be, the simplest first.

    Args:
        evidence: the pair.
        other_view: channels of the file of A that is the other of the left and right view.
    """
    rows, columns = evidence.places
    if other_view is not None and all(name in other_view for name in evidence.names):
        planes = [other_view[name] for name in evidence.names]
        if all(plane.shape == evidence.size for plane in planes):
            yield _swapped_views(evidence, planes)
    height, width = evidence.size
    moves = {
        "flipped left to right": (rows, width - 1 - columns),
        "flipped upside down": (height - 1 - rows, columns),
        "rotated by 180°": (height - 1 - rows, width - 1 - columns),
    }
    if height == width:
        moves |= {
            "rotated by 90° to the left": (columns, width - 1 - rows),
            "rotated by 90° to the right": (height - 1 - columns, rows),
            "flipped over its diagonal": (columns, rows),
        }
    for text, (y, x) in moves.items():
        predicted, _ = evidence.gathered(evidence.a, y, x)
        yield Explanation(Finding(text.split()[0], text), evidence.left(predicted))
    if width % 2 == 0:
        predicted, _ = evidence.gathered(evidence.a, rows, (columns + width // 2) % width)
        text = "left and right swapped: the halves of the picture"
        yield Explanation(Finding("left and right swapped", text), evidence.left(predicted))
    yield from _cropped(evidence)
    yield from _shifted(evidence)


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


def _swapped_views(evidence: Evidence, planes: list[NDArray[Any]]) -> Explanation:
    rows, columns = evidence.places
    predicted = np.stack([plane[rows, columns] for plane in planes]).astype(np.float32)
    finding = Finding("left and right swapped", "left and right swapped")
    return Explanation(finding, evidence.left(np.nan_to_num(predicted)))


def _cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside of a window, and as A within it."""
    kept = (evidence.b != 0).any(axis=0)
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


def _shifted(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by whole pixels or by fractions; what comes in at the border may be anything."""
    rows, columns = evidence.places
    tried: list[tuple[float, int, int]] = []
    for dx, dy in _offsets(evidence):
        predicted, within = evidence.gathered(evidence.a, rows - dy, columns - dx)
        tried.append((evidence.left(predicted, within), dx, dy))
    tried.sort(key=lambda each: (round(each[0], 2), abs(each[1]) + abs(each[2])))
    for left, dx, dy in tried[:1]:
        if (dx, dy) != (0, 0):
            values = {"dx": dx, "dy": dy}
            yield Explanation(Finding("shifted", f"shifted by ({dx}, {dy})", values), left)
        if left > _LARGEST_PART:
            yield from _shifted_by_parts(evidence, dx, dy)


def _offsets(evidence: Evidence) -> list[tuple[int, int]]:
    """Shifts (dx, dy) worth trying: peaks of correlations, and small ones."""
    a, b = (_frame(planes) for planes in (evidence.a, evidence.b))
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


def _frame(planes: NDArray[np.float32]) -> NDArray[np.float64]:
    """The mean of the channels in the middle of a picture, compressed."""
    height, width = planes.shape[1:]
    high, wide = min(height, _FRAME), min(width, _FRAME)
    top, left = (height - high) // 2, (width - wide) // 2
    middle = planes[:, top : top + high, left : left + wide].mean(axis=0, dtype="f8")
    frame: NDArray[np.float64] = compressed(middle)
    return frame


def _shifted_by_parts(evidence: Evidence, dx: int, dy: int) -> Iterator[Explanation]:
    """A shift with a fraction: by least squares on the gradient, tried with cubic interpolation."""
    a, b = (_frame(planes) for planes in (evidence.a, evidence.b))
    a = np.roll(a, (dy, dx), axis=(0, 1))
    cut = max(abs(dx), abs(dy)) + 2
    if min(a.shape) < 2 * cut + 8:
        return
    inner = (slice(cut, -cut), slice(cut, -cut))
    shift: NDArray[np.float64] = np.zeros(2)
    moved = a
    for _ in range(3):
        slopes: Any = np.gradient(moved)
        slope_y, slope_x = (slope[inner].ravel() for slope in slopes)
        rest = (b - moved)[inner].ravel()
        crossed = float((slope_x * slope_y).sum())
        square = [[float((slope_x**2).sum()), crossed], [crossed, float((slope_y**2).sum())]]
        try:
            aim = [float((slope_x * rest).sum()), float((slope_y * rest).sum())]
            shift = shift - np.linalg.solve(square, aim)
        except np.linalg.LinAlgError:
            return
        if not np.abs(shift).max() < 2:
            return
        moved = _moved(a, float(shift[0]), float(shift[1]))
    if np.abs(shift).max() < _LARGEST_PART:
        return
    whole = float(np.square(b - _frame(evidence.a))[inner].mean())
    left = (float(np.square(b - moved)[inner].mean()) / whole) ** 0.5 if whole else 1.0
    if left <= _PART_LEFT:
        x, y = dx + float(shift[0]), dy + float(shift[1])
        finding = Finding("shifted", f"shifted by ({x:.2f}, {y:.2f})", {"dx": x, "dy": y})
        yield Explanation(finding, left * 0.1 / _PART_LEFT)


def _moved(values: NDArray[np.float64], dx: float, dy: float) -> NDArray[np.float64]:
    """Values [h, w] moved by fractions of a pixel, with cubic interpolation (Keys, −1/2)."""
    for axis, part in ((0, dy), (1, dx)):
        whole = int(np.floor(part))
        t = 1 - (part - whole)  # sample between the pixels whole + 1 and whole before
        weights = (
            ((-0.5 * t + 1.0) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1.0,
            ((-1.5 * t + 2.0) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        )
        steps = (whole + 2, whole + 1, whole, whole - 1)
        moved = np.zeros_like(values)
        for step, weight in zip(steps, weights, strict=True):
            moved += weight * np.roll(values, step, axis=axis)
        values = moved
    return values


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
