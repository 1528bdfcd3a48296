"""The lens in front of a depth map: focus distance, CoC radius, and quality within a tolerance.

A random lens whose blur exceeds ``max_coc``, or which cannot focus on the picture, is drawn again,
`ATTEMPTS` times in all.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

from defocus_core.batch.depth.matching import matched
from defocus_core.batch.jobs.job import Machine
from defocus_core.batch.jobs.lens_from_options import refuse_near_focus
from defocus_core.batch.jobs.random_lenses import drawn_lens
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.quantities import Percentile, length_text
from defocus_core.errors import InputError, Rejected, UsageProblem, reason
from defocus_core.io.arrays import Keeping, bands

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from defocus_core.io.depth_formats.depth import Depth
    from defocus_core.renderer.defocus_lens import DefocusLens

MM_PER_M = 1000.0
_MOST_PX = 1e6  # wider than any frame
_FARTHEST_PX = 1e8  # what the renderer takes


def focused(lens: Lens, depth: Depth) -> Lens:
    """The lens with its focus distance, drawn again if it does not suit the picture.

    Raises:
        UsageProblem: the focus lies outside the picture, or too near.
        Rejected: the blur would be larger than ``max_coc``, or the depth holds nothing to focus on.
    """
    from defocus_core.optics.distributions import ATTEMPTS

    for attempt in range(ATTEMPTS):
        if attempt and lens.draw is not None:
            draw = dataclasses.replace(lens.draw, attempt=attempt)
            again = drawn_lens(draw, lens.focus_source, lens.max_coc)
            lens = dataclasses.replace(again, radii_px=lens.radii_px)
        try:
            return _within_max_coc(_focused_once(lens, depth), depth)
        except Rejected as error:
            if lens.draw is None:
                raise
            rejected = error
    problem = f"{rejected.problem}, with the last of {ATTEMPTS} lenses drawn for it"
    raise Rejected(rejected.code, problem, rejected.remedy, path=rejected.place)


def signed_radius(
    lens: Lens, metres: NDArray[np.float32], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Signed CoC radius in px at depths in metres, for pictures of ``size`` (width, height).

    Raises:
        UsageProblem: there is no such lens, or its blur is beyond all numbers.
    """
    import numpy as np
    import torch

    depth_mm = torch.from_numpy(metres.astype("float64")) * MM_PER_M
    radius: NDArray[np.float32] = _thin_lens(lens, size).signed_radius(depth_mm).float().numpy()
    if not np.isfinite(radius).all():
        problem = f"f/{lens.fnum:g} blurs beyond all numbers in this picture"
        raise UsageProblem(
            "out-of-range", problem, "check the lens options and the depth's unit", field="fnumber"
        )
    return radius


def radius_at_infinity(lens: Lens, size: tuple[int, int]) -> float:
    """Signed CoC radius in px of what is infinitely far, in pictures of ``size`` (width, height).

    Raises:
        UsageProblem: there is no such lens.
    """
    return _thin_lens(lens, size).radius_at_infinity()


def lens_scale(lens: Lens, size: tuple[int, int]) -> float:
    """Px of radius for a disparity of 1 per mm, in pictures of ``size`` (width, height).

    Raises:
        UsageProblem: there is no such lens.
    """
    import torch

    thin_lens = _thin_lens(lens, size)
    near = float(thin_lens.signed_radius(torch.tensor([MM_PER_M], dtype=torch.float64)))
    return float(thin_lens.radius_at_infinity() - near) * MM_PER_M


def color_offsets(lens: Lens, size: tuple[int, int]) -> tuple[float, float]:
    """Px by which the signed radii of red and of blue differ from those of green.

    Raises:
        UsageProblem: there is no such lens.
    """
    from defocus_core.optics.axial_color import color_offset

    assert lens.axial_color is not None
    thin_lens = _thin_lens(lens, size)
    red, blue = (float(color_offset(thin_lens, shift)) for shift in lens.axial_color)
    return red, blue


def radius_map(lens: Lens, depth: Depth, keeping: Keeping) -> tuple[Any, tuple[float, float]]:
    """The signed CoC radius in px of a whole frame [H, W], float32, and its smallest and largest.

    Where there is nothing, it is the largest: nothing lies before nothing, and what lies beside it
    is seen through the whole lens.

    Raises:
        InputError: a depth is so near, or the focus, that no frame would hold the blur.
    """
    metres = depth.metres
    if depth.is_radius:
        whole, ends = metres, _ends_of_radii(depth)
    else:
        whole = keeping.new(metres.shape, "float32")
        found = []
        for rows in bands(metres.shape):
            radius = signed_radius(lens, metres[rows], depth.size)
            whole[rows] = radius
            if depth.nothing is not None:
                radius = radius[~depth.nothing[rows]]
            if radius.size:
                found += [float(radius.min()), float(radius.max())]
                _refuse_blur(found[-2:], depth, rows)
        ends = (min(found), max(found)) if found else (0.0, 0.0)
    return (whole if depth.nothing is None else _with_nothing(whole, ends[1], depth)), ends


def _refuse_blur(ends: list[float], depth: Depth, rows: slice) -> None:
    """Refuse radii that no frame would hold.

    Raises:
        InputError: a depth is so near, or the focus.
    """
    if not -ends[0] <= _MOST_PX:
        nearest = float(depth.something(rows).min())
        problem = f"has a depth of {nearest:.3g} m, which is blurred by {-ends[0]:.2g} px"
        raise InputError("too-blurred", problem, "check ‹depth-unit› and ‹focus›", path=depth.path)
    if not ends[1] <= _FARTHEST_PX:
        problem = f"is blurred by {ends[1]:.2g} px: focus is hardly beyond the focal length"
        raise InputError("out-of-range", problem, "give ‹focus› in the scene", path=depth.path)


def _with_nothing(radius: Any, farthest: float, depth: Depth) -> Any:
    """The radii, the farthest where there is nothing; in place."""
    import numpy as np

    for rows in bands(radius.shape):
        radius[rows] = np.where(depth.nothing[rows], np.float32(farthest), radius[rows])
    return radius


def _ends_of_radii(depth: Depth) -> tuple[float, float]:
    """The least and greatest radius of a file of radii, in px.

    Raises:
        InputError: a radius is so large that no frame would hold the blur.
    """
    of_bands = [depth.something(rows) for rows in bands(depth.metres.shape)]
    least = min((float(radius.min()) for radius in of_bands if radius.size), default=0.0)
    most = max((float(radius.max()) for radius in of_bands if radius.size), default=0.0)
    if max(-least, most) > _MOST_PX:
        problem = f"has a CoC radius of {max(-least, most):.2g} px"
        raise InputError("too-blurred", problem, "check ‹depth-format› coc", path=depth.path)
    return least, most


def _thin_lens(lens: Lens, size: tuple[int, int]) -> DefocusLens:
    """The lens in front of a sensor of ``size`` (width, height) px."""
    import torch

    from defocus_core.renderer.defocus_lens import DefocusLens

    width, height = size
    sensor = (lens.sensor_width, lens.sensor_width * height / width)
    try:
        thin_lens = DefocusLens(
            lens.foclen, lens.fnum, sensor, (width, height), "cpu", torch.float64
        )
        thin_lens.refocus(math.inf if lens.foc_dist is None else lens.foc_dist)
        thin_lens.sharp_range = lens.sharp_range
    except ValueError as error:
        option = lens.focus_source.at("focus")
        raise UsageProblem(
            "out-of-range", reason(error), "check the lens options", path=option
        ) from error
    return thin_lens


def _focused_once(lens: Lens, depth: Depth) -> Lens:
    """The lens with the focus distance that the depth decides, and the f-number if it does."""
    if lens.radii_px is not None:
        return matched(lens, depth)
    if lens.focus_at is not None:
        return dataclasses.replace(lens, foc_dist=_at_pixel(lens, lens.focus_at, depth))
    if lens.focus_percentile is not None:
        return dataclasses.replace(lens, foc_dist=_at_percentile(lens, depth))
    return lens


def _at_pixel(lens: Lens, pixel: tuple[int, int], depth: Depth) -> float:
    (x, y), (width, height) = pixel, depth.size
    option = lens.focus_source.at("focus-at")
    if not (0 <= x < width and 0 <= y < height):
        raise UsageProblem(
            "out-of-range",
            f"{x},{y} lies outside {depth.path} of {width}x{height} px",
            f"give X from 0 to {width - 1} and Y from 0 to {height - 1}",
            path=option,
        )
    row, column = y + depth.overscan.top, x + depth.overscan.left
    place = slice(row, row + 1), slice(column, column + 1)
    if depth.nothing is not None and depth.nothing[place].any():
        problem = f"{x},{y} has an alpha of 0 in {depth.path}, and nothing to focus on"
        raise UsageProblem("no-valid-depth", problem, "give a pixel of the element", path=option)
    foc_dist = float(depth.metres[place][0, 0]) * MM_PER_M
    refuse_near_focus(foc_dist, lens.foclen, option, f"{depth.path} at {x},{y}: ")
    return foc_dist


def _at_percentile(lens: Lens, depth: Depth) -> float:
    import torch

    from defocus_core.tensors.order_statistics import depth_percentile

    assert lens.focus_percentile is not None
    metres = depth_percentile(
        lambda: (torch.from_numpy(depth.metres[rows]) for rows in bands(depth.metres.shape)),
        lens.focus_percentile,
        torch.float32,
    )
    if metres is None:
        remedy = "give the focus as a distance"
        what = "is all sky" if depth.nothing is None else "is sky or has an alpha of 0 everywhere"
        problem = f"{what}, with nothing to focus on"
        raise Rejected("no-valid-depth", problem, remedy, path=depth.path)
    foc_dist = metres * MM_PER_M
    if foc_dist <= lens.foclen:
        where, far = Percentile(lens.focus_percentile), length_text(lens.foclen)
        problem = f"has {length_text(foc_dist)} at {where}, not beyond the focal length {far}"
        raise Rejected("focus-too-near", problem, "focus farther away", path=depth.path)
    return foc_dist


def _within_max_coc(lens: Lens, depth: Depth) -> Lens:
    """The lens, unless its blur exceeds ``max_coc`` in this picture."""
    import numpy as np

    if lens.max_coc is None:
        return lens
    strips = (depth.something(rows) for rows in bands(depth.metres.shape))
    ends = np.array([(metres.min(), metres.max()) for metres in strips if metres.size])
    if not ends.size:
        return lens
    extremes = np.array([ends.min(), ends.max()])
    if not depth.is_radius:
        extremes = signed_radius(lens, extremes, depth.size)
    radius = float(np.abs(extremes).max())
    if radius > lens.max_coc:
        problem = f"would get a CoC radius of {radius:.2f} px, more than {lens.max_coc:g}px"
        raise Rejected("coc-too-large", problem, "allow a larger max-coc", path=depth.path)
    return lens


def quality_of(machine: Machine, coc_px: tuple[float, float]) -> str:
    """The quality of a picture whose signed radii in px have the given ends.

    Raises:
        UsageProblem: no quality is within the tolerance.
    """
    if machine.tolerance is None:
        return machine.quality
    from defocus_core.renderer.layers.ladder import UnreachableTolerance, cheapest_within

    try:
        return cheapest_within(machine.tolerance, *coc_px)
    except UnreachableTolerance as error:
        problem = (
            f"must be at least {error.finest:g} px where radii go from {error.least:.1f} to "
            f"{error.most:.1f} px, got {error.tolerance:g}"
        )
        remedy = f"give more: that is what {error.quality} has"
        raise UsageProblem("out-of-range", problem, remedy, field="tolerance") from None
