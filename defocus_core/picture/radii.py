"""The signed radii of a depth through a lens: the one way from metres to px of radius."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.io.arrays import IN_MEMORY, Keeping, bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color import Color
from defocus_core.picture.sources import map_windows, windows
from defocus_core.request.job import Reading
from defocus_core.request.lens import Lens
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.optics.thin_lens import ThinLens
    from defocus_core.tensors.source import Pixels

MM_PER_M = 1000.0
_NEAREST = 1e-12  # m; nothing is as near
_MAX_PX = 1e6  # wider than any frame
_FARTHEST_PX = 1e8  # what the renderer takes


class Radii(NamedTuple):
    """The signed radii of the circle of confusion of a frame."""

    # [H, W] float32. Where there is nothing, it is the greatest: nothing lies before nothing,
    # and what lies beside it is seen through the whole lens
    px: Any
    limits: tuple[float, float]  # the least and the greatest of them, of what is there
    infinity: float | None  # of what is infinitely far; None where the file holds radii
    scale: float  # px for a disparity of 1 per mm; 1 where the file holds radii
    # What became of radii that were larger than the lens lets them be, in words
    warnings: tuple[str, ...] = ()

    def repair(self, color: Color, reading: Reading) -> tuple[Pixels, DepthRepair]:
        """The radii [H, W] px by which a picture is rendered, and the repair that made them."""
        import torch

        from defocus_core.depth.repair import repair_depth

        return repair_depth(
            map_windows(self.px, "cpu"),
            windows(color.planes, "cpu"),
            self.infinity,
            torch.get_num_threads(),
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
        )

    def diagnose(self, reading: Reading) -> DepthRepair:
        """The repair that they need to be rendered, as far as it shows without colours."""
        import torch

        from defocus_core.depth.repair import diagnose_depth

        return diagnose_depth(
            map_windows(self.px, "cpu"),
            self.infinity,
            torch.get_num_threads(),
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
        )


def radii_of(lens: Lens, depth: Depth, keeping: Keeping = IN_MEMORY) -> Radii:
    """The radii of a whole frame; those of a file of radii as they are."""
    import torch

    px, infinity, scale = depth.metres, None, 1.0
    if isinstance(lens.blur, float):
        px = _relative(lens.blur, lens, depth, keeping)
    elif not depth.is_radius:
        thin_lens, px = thin_lens_of(lens, depth.size), keeping.new(depth.metres.shape, "float32")
        for rows in bands(px.shape):
            px[rows] = _through(thin_lens, depth.metres[rows], depth.path)
        infinity = thin_lens.radius_at_infinity()
        near = float(thin_lens.signed_radius(torch.tensor([MM_PER_M], dtype=torch.float64)))
        scale = (infinity - near) * MM_PER_M
    limits = _limits_of(px, depth)
    for rows in bands(px.shape) if depth.empty is not None else ():
        px[rows] = np.where(depth.empty[rows], np.float32(limits[1]), px[rows])
    radii = Radii(px, limits, infinity, scale)
    return radii if lens.clamp_blur is None else _clamp(radii, lens.clamp_blur, depth, keeping)


def _relative(blur: float, lens: Lens, depth: Depth, keeping: Keeping) -> Any:
    """The radii of relative disparity, linear in its numbers."""
    import torch

    from defocus_core.depth.distance_scale import radius_from_relative_disparity

    assert lens.focus_value is not None
    assert lens.blur_reach is not None, "with_blur_reach() is for this"
    if blur > _MAX_PX:
        problem = f"is blurred by {blur:.2g} px"
        raise InputError("too-blurred", problem, "give a smaller ‹blur›", path=depth.path)
    reach = lens.blur_reach
    largest = -blur if depth.inverted else blur
    whole = keeping.new(depth.metres.shape, "float32")
    for rows in bands(depth.metres.shape):
        disparity = torch.from_numpy(depth.metres[rows].astype("float64"))
        radius = radius_from_relative_disparity(disparity, lens.focus_value, largest, reach)
        if lens.sharp_range is not None:
            low, high = lens.sharp_range
            radius[(disparity >= low) & (disparity <= high)] = 0.0
        whole[rows] = radius.float().numpy()
    return whole


def _clamp(radii: Radii, limit: float, depth: Depth, keeping: Keeping) -> Radii:
    """The radii of which none is larger than ``limit`` px."""
    clamped = 0
    whole = keeping.new(radii.px.shape, "float32")  # those of a file are other jobs', too
    for rows in bands(radii.px.shape):
        larger = np.abs(radii.px[rows]) > np.float32(limit)
        if depth.empty is not None:
            larger &= ~depth.empty[rows]
        clamped += int(np.count_nonzero(larger))
        whole[rows] = np.clip(radii.px[rows], -limit, limit)

    def within(radius: float) -> float:
        return min(max(radius, -limit), limit)

    infinity = None if radii.infinity is None else within(radii.infinity)
    limits = within(radii.limits[0]), within(radii.limits[1])
    words = f"radius of {counted(clamped, 'pixel')} clamped to {limit:g} px"
    warnings = (words,) if clamped else ()
    return radii._replace(px=whole, limits=limits, infinity=infinity, warnings=warnings)


def signed_radius(
    lens: Lens, metres: NDArray[np.float32], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Signed CoC radius in px at depths in metres, for pictures of ``size`` (width, height)."""
    return _through(thin_lens_of(lens, size), metres)


def color_offsets(lens: Lens, size: tuple[int, int]) -> tuple[float, float]:
    """Px by which the signed radii of red and of blue differ from those of green.

    Of a blur in px the shifts are shares of it.
    """
    from defocus_core.optics.axial_color import color_offset

    assert lens.axial_color is not None
    if isinstance(lens.blur, float):
        red, blue = (-share * lens.blur for share in lens.axial_color)
        return red, blue
    thin_lens = thin_lens_of(lens, size)
    red, blue = (float(color_offset(thin_lens, shift)) for shift in lens.axial_color)
    return red, blue


def thin_lens_of(lens: Lens, size: tuple[int, int]) -> ThinLens:
    """The lens in front of a sensor of ``size`` (width, height) px."""
    import torch

    from defocus_core.optics.thin_lens import ThinLens

    width, height = size
    sensor = (lens.sensor_width, lens.sensor_width * height / width)
    try:
        thin_lens = ThinLens(lens.foclen, lens.fnum, sensor, (width, height), "cpu", torch.float64)
        thin_lens.refocus(math.inf if lens.foc_dist is None else lens.foc_dist)
        thin_lens.sharp_range = lens.sharp_range
    except ValueError as error:
        option = lens.focus_source.at("focus")
        raise UsageProblem(
            "out-of-range", reason(error), "check the lens options", path=option
        ) from error
    return thin_lens


def _through(
    thin_lens: ThinLens, metres: NDArray[np.float32], path: Path | None = None
) -> NDArray[np.float32]:
    """The law in float64, rounded once; `path`: the file of the depth, if it is of one."""
    import torch

    depth_mm = torch.from_numpy(metres.astype("float64")) * MM_PER_M
    radius: NDArray[np.float32] = thin_lens.signed_radius(depth_mm).float().numpy()
    if not (finite := np.isfinite(radius)).all():
        if path is not None and (nearest := float(metres[~finite].min())) < _NEAREST:
            problem = f"has a depth of {nearest:.3g} m, which is blurred beyond all numbers"
            raise InputError("too-blurred", problem, "check ‹depth-unit› and ‹focus›", path=path)
        problem = f"f/{float(thin_lens.fnum):g} blurs beyond all numbers in this picture"
        raise UsageProblem(
            "out-of-range", problem, "check the lens options and the depth's unit", field="fnumber"
        )
    return radius


def _limits_of(px: Any, depth: Depth) -> tuple[float, float]:
    """The least and greatest radius, in px, of what is there; not of what no frame would hold."""
    ends: list[float] = []
    for rows in bands(px.shape):
        radius = px[rows] if depth.empty is None else px[rows][~depth.empty[rows]]
        ends += [float(radius.min()), float(radius.max())] if radius.size else []
    least, greatest = min(ends, default=0.0), max(ends, default=0.0)
    remedy = "check ‹depth-unit› and ‹focus›"
    if depth.is_radius and not depth.is_relative and max(-least, greatest) > _MAX_PX:
        problem, remedy = (
            f"has a CoC radius of {max(-least, greatest):.2g} px",
            "check ‹depth-format› coc",
        )
    elif not depth.is_radius and not -least <= _MAX_PX:
        nearest = min(
            float(each.min()) for rows in bands(px.shape) if (each := depth.present(rows)).size
        )
        problem = f"has a depth of {nearest:.3g} m, which is blurred by {-least:.2g} px"
    elif not depth.is_radius and not greatest <= _FARTHEST_PX:
        problem = f"is blurred by {greatest:.2g} px: focus is hardly beyond the focal length"
        raise InputError("out-of-range", problem, "give ‹focus› in the scene", path=depth.path)
    else:
        return least, greatest
    raise InputError("too-blurred", problem, remedy, path=depth.path)
