"""Evidence of a colour and a depth file together: colour already blurred, depth laid elsewhere.

Sharp colour has sharp edges at every depth, and edges where the depth has them. Both are measured;
neither changes what is rendered. Only strong evidence is told.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.job import Reading
from defocus_core.io.arrays import IN_MEMORY, Keeping
from defocus_core.io.depth_formats.depth import read_depth
from defocus_core.io.images.color import read_color
from defocus_core.picture.steps.alpha import element_depth

if TYPE_CHECKING:
    Floats = NDArray[np.float32]

_WINDOW = 2048  # px, side of the middle of the picture that is measured
# Widths of edges are measured at two scales, standard deviations in px.
_FINE, _COARSE = 1, 2
_MIN_STEP = 0.02  # least gradient of an edge, in parts of white a px
# Of the edges at one range of depths, the sharpest quarter tells how sharp the colour is there.
_QUARTER, _MIN_EDGES, _RANGES = 25, 300, 6
_SHARP_PX, _BLURRED_PX = 1.0, 1.6  # standard deviation of an edge: as good as sharp, surely blurred
_JUMP = 0.1  # least step of depth at an edge, as a share of the nearer
_MIN_JUMPS = 500
_REACH = 0.06  # farthest shift that is tried, as a share of the side
_MIN_SHIFT = 3  # px; depth edges of networks lie less exactly
# A place is told if colour has so many standard deviations more gradient there than at a typical
# place, and so many times what it has above a typical place where the depth lies now.
_CLEAR, _CLEARER = 7.0, 2.0


def evidence_of_pair(
    color: Path,
    depth: Path,
    reading: Reading,
    *,
    keeping: Keeping = IN_MEMORY,
    lens_focal: float | None = None,
) -> tuple[str, ...]:
    """Sentences on what is wrong between colour and depth of one size; empty if nothing."""
    image = read_color(
        color,
        layer=reading.color_layer,
        part=None,
        view=reading.view,
        keeping=keeping,
        carried=False,
    )
    height, width = image.shape[:2]
    beside = read_depth(
        depth,
        reading,
        keeping=keeping,
        size=(width, height),
        lens_focal=lens_focal,
        alpha=image.alpha,
        orientation=image.orientation,
    )
    if beside.metres.shape != (height, width):
        return ()
    metres = element_depth(beside, image, keeping).metres
    rows, columns = _middle(height), _middle(width)
    near = metres[rows][:, columns]
    planes = [plane[rows][:, columns] for plane in image.planes[:3]]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        disparity = np.where(near > 0, 1 / near, 0).astype(np.float32)  # holes count as far
        light = np.mean(planes, 0, dtype=np.float32)
    white = float(np.percentile(light, 99)) or 1.0
    seen: Floats = np.power(np.clip(np.nan_to_num(light) / white, 0, 1), np.float32(1 / 2.2))
    return tuple(filter(None, (_blurred(seen, disparity), _misplaced(seen, disparity))))


def _middle(length: int) -> slice:
    start = max(length - _WINDOW, 0) // 2
    return slice(start, start + min(length, _WINDOW))


def _blurred(seen: Floats, disparity: Floats) -> str:
    """A sentence if edges are wide at one range of depths, or at all; else empty."""
    fine, coarse = (_gradient(_smoothed(seen, scale)) for scale in (_FINE, _COARSE))
    is_edge = _is_crest(fine) & (fine > _MIN_STEP)
    # An edge of standard deviation s, smoothed by a, has a gradient that goes with 1/√(s² + a²).
    ratio = np.square(fine[is_edge] / np.maximum(coarse[is_edge], 1e-6))
    variance = (_COARSE**2 - ratio * _FINE**2) / np.maximum(ratio - 1, 1e-3)
    order = np.argsort(disparity[is_edge], kind="stable")
    groups = np.array_split(order, _RANGES)
    if len(groups[-1]) < _MIN_EDGES:
        return ""
    widths = [float(np.percentile(variance[group], _QUARTER)) for group in groups]
    widths = [max(width, 0) ** 0.5 for width in widths]
    widest = int(np.argmax(widths))
    if widths[widest] < _BLURRED_PX:
        return ""
    if min(widths) >= _BLURRED_PX:
        spread = f"three quarters of its edges have a spread of {min(widths):.1f} px and more"
        return f"warning: the colour looks blurred everywhere: {spread}; take a sharp picture"
    if min(widths) > _SHARP_PX:
        return ""
    at = float(np.median(disparity[is_edge][groups[widest]]))
    where = f"at {1 / at:.3g} m" if at > 0 else "far away"
    spread = f"edges have a spread of {widths[widest]:.1f} px {where}"
    sharp = f"{min(widths):.1f} px where they are sharpest"
    remedy = "take a picture that is in focus everywhere"
    return f"warning: the colour looks blurred already: {spread}, {sharp}; {remedy}"


def _misplaced(seen: Floats, disparity: Floats) -> str:
    """A sentence if the edges of depth lie on edges of colour elsewhere or mirrored; else empty."""
    gradient = _gradient(_smoothed(seen, _FINE))
    strength = np.minimum(gradient, np.percentile(gradient, 95))
    strength = strength - strength.mean()
    jumps = _jumps(disparity)
    if jumps.sum() < _MIN_JUMPS:
        return ""
    reach = int(_REACH * max(seen.shape))
    here, at, score = _best_place(strength, jumps, reach)
    if max(map(abs, at)) >= _MIN_SHIFT and score > _CLEAR and score > _CLEARER * max(here, 0):
        right, down = at
        shift = f"{right:+d} px to the right and {down:+d} px down"
        problem = "colour and depth do not lie on each other"
        return f"warning: {problem}: the colour has the edges of the depth {shift}; align them"
    for axis, word in ((0, "upside down"), (1, "mirrored left to right")):
        _, _, score = _best_place(strength, np.flip(jumps, axis), reach)
        if score > _CLEAR and score > _CLEARER * max(here, 0):
            problem = "colour and depth do not lie on each other"
            return f"warning: {problem}: the colour has the edges of the depth {word}; turn one"
    return ""


def _best_place(
    strength: Floats, jumps: Floats, reach: int
) -> tuple[float, tuple[int, int], float]:
    """How well depth edges lie on colour edges, in standard deviations of all shifts tried.

    Returns the score without a shift (the best within a px), the best shift (right, down) in px,
    and its score.
    """
    spectrum = np.conj(np.fft.rfft2(jumps)) * np.fft.rfft2(strength)
    tried = np.roll(np.fft.irfft2(spectrum, strength.shape), (reach, reach), (0, 1))
    tried = tried[: 2 * reach + 1, : 2 * reach + 1]
    tried = (tried - np.median(tried)) / (np.std(tried) + 1e-12)
    down, right = np.unravel_index(int(np.argmax(tried)), tried.shape)
    here = tried[reach - 1 : reach + 2, reach - 1 : reach + 2].max()
    return float(here), (int(right) - reach, int(down) - reach), float(tried.max())


def _jumps(disparity: Floats) -> Floats:
    """Where depth has a step, 1 at the nearer side of it."""
    jumps = np.zeros(disparity.shape, np.float32)
    for one, other in (
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:-1], np.s_[1:]),
    ):
        jumps[one] = np.maximum(jumps[one], disparity[one] > (1 + _JUMP) * disparity[other])
    return jumps


def _smoothed(image: Floats, scale: float) -> Floats:
    """An image smoothed by a Gaussian of a standard deviation in px; edges are continued."""
    reach = int(3 * scale)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / scale)).astype(np.float32)
    weights /= weights.sum()
    for axis in (0, 1):
        margins = [(reach, reach) if axis == each else (0, 0) for each in (0, 1)]
        views = np.lib.stride_tricks.sliding_window_view(
            np.pad(image, margins, mode="edge"), len(weights), axis
        )
        image = views @ weights
    return image


def _gradient(image: Floats) -> Floats:
    """Length of the gradient of an image, per px."""
    down, right = np.gradient(image)
    length: Floats = np.hypot(down, right)
    return length


def _is_crest(gradient: Floats) -> NDArray[np.bool_]:
    """Where a gradient is not less than that of both neighbours in a row or in a column."""
    crest = np.zeros(gradient.shape, bool)
    middle = gradient[1:-1, 1:-1]
    in_row = (middle >= gradient[1:-1, :-2]) & (middle >= gradient[1:-1, 2:])
    in_column = (middle >= gradient[:-2, 1:-1]) & (middle >= gradient[2:, 1:-1])
    crest[1:-1, 1:-1] = in_row | in_column
    return crest
