"""Signed blur radii from depth and lens: the only conversion from metres to px of radius."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.io.arrays import computed
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.picture.take import Radii, Take
from defocus_core.request.lens import LensValues
from defocus_core.request.quantities import length_text
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.optics.thin_lens import ThinLens


MM_PER_M = 1000.0
_NEAREST = 1e-12  # m; nearer than any scene
_MAX_PX = 1e6  # px, wider than any frame
_FARTHEST_PX = 1e8  # px, limit of the renderer


def radii_of(lens: LensValues, depth: Depth) -> Radii:
    """The signed blur radii of a depth map through a lens; radii in a file are used as they are."""
    px, infinity, scale = depth.metres, None, 1.0
    if isinstance(lens.blur, float):
        px = _relative(lens.blur, lens, depth)
    elif not depth.is_radius:
        law = _Law.from_lens(lens, depth.size)
        px = computed(law.radii, depth.metres)
        _refuse_infinite(px, lens.fnum, depth.metres, depth.path)
        infinity = law.radius(math.inf)
        scale = (infinity - law.radius(MM_PER_M)) * MM_PER_M
    limits = _limits_of(px, depth)
    if depth.empty is not None:
        px[depth.empty] = limits[1]
    radii = Radii(px, limits, infinity, scale)
    return radii if lens.clamp_blur is None else _clamp(radii, lens.clamp_blur, depth)


def _relative(blur: float, lens: LensValues, depth: Depth) -> Any:
    """Signed radii [H, W] of relative disparity: linear in its numbers, 0 in the sharp range."""
    import torch

    from defocus_core.depth.ramps import radius_from_relative_disparity

    reach = lens.blur_reach
    assert reach is not None, "with_blur_reach() is for this"
    largest = -blur if depth.inverted else blur
    ends = sharp_numbers(lens)

    def radius(numbers: NDArray[np.float32]) -> Any:
        disparity = torch.from_numpy(numbers.astype("float64"))
        beyond = disparity - disparity.clamp(*ends)
        return radius_from_relative_disparity(beyond, 0.0, largest, reach).float().numpy()

    return computed(radius, depth.metres)


def sharp_numbers(lens: LensValues) -> tuple[float, float]:
    """The least and the greatest depth number in focus, for a lens with ``blur``."""
    assert lens.focus_value is not None
    numbers = (lens.focus_value, *(lens.sharp_range or ()))
    return min(numbers), max(numbers)


def _clamp(radii: Radii, limit: float, depth: Depth) -> Radii:
    """The radii limited to magnitudes of at most ``limit`` px, with a warning if any was larger."""
    larger = np.abs(radii.px) > np.float32(limit)
    if depth.empty is not None:
        larger &= ~depth.empty
    clamped = int(np.count_nonzero(larger))
    whole = np.clip(radii.px, -limit, limit)  # other jobs share those of a file

    def clamp(radius: float) -> float:
        return min(max(radius, -limit), limit)

    infinity = None if radii.infinity is None else clamp(radii.infinity)
    limits = clamp(radii.limits[0]), clamp(radii.limits[1])
    words = f"radius of {counted(clamped, 'pixel')} clamped to {limit:g} px"
    warnings = (words,) if clamped else ()
    return radii._replace(px=whole, limits=limits, infinity=infinity, warnings=warnings)


def signed_radius(
    lens: LensValues, metres: NDArray[np.float32], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Signed CoC radii in px at depths in metres, for pictures of ``size`` (width, height) px."""
    radius = _Law.from_lens(lens, size).radii(metres)
    _refuse_infinite(radius, lens.fnum, metres)
    return radius


class _Law(NamedTuple):
    """The CoC of a lens by distance, as in `optics.thin_lens`, for NumPy arrays."""

    per_disparity: float  # A v in mm²
    focus: float  # 1 / s per mm
    pixels: float  # mm of two pixels
    sharp: tuple[float, float] | None  # the range in mm that has a radius of 0, too

    @classmethod
    def from_lens(cls, lens: LensValues, size: tuple[int, int]) -> Self:
        """The law of a lens for pictures of ``size`` (width, height) px."""
        from defocus_core.optics.law import coc_per_disparity

        s = math.inf if lens.foc_dist is None else lens.foc_dist
        if not lens.foclen < s:
            thin_lens_of(lens, size)  # says what is wrong
        per_disparity = coc_per_disparity(lens.foclen, lens.fnum, s)
        return cls(per_disparity, 1 / s, 2 * (lens.sensor_width / size[0]), lens.sharp_range)

    def radius(self, distance: float) -> float:
        """The signed radius in px at a distance in mm, regardless of the sharp range."""
        from defocus_core.optics.law import coc_of

        return float(coc_of(self.per_disparity, self.focus, distance) / self.pixels)

    def radii(self, metres: NDArray[np.float32]) -> NDArray[np.float32]:
        """Signed radii in px at depths in metres; 0 within the sharp range."""
        from defocus_core.optics.law import coc_of

        z = metres.astype("float64") * MM_PER_M
        with np.errstate(over="ignore", invalid="ignore"):  # refused by the caller
            radius: NDArray[np.float32] = coc_of(self.per_disparity, self.focus, z)
            radius = (radius / self.pixels).astype("float32")
        if self.sharp is not None:
            radius[(z >= self.sharp[0]) & (z <= self.sharp[1])] = 0
        return radius


def color_offsets(lens: LensValues, size: tuple[int, int]) -> tuple[float, float]:
    """How much the signed radii of red, and of blue, exceed that of green, in px.

    For a lens with ``blur``, the option axial-color gives shares of that blur.
    """
    from defocus_core.optics.axial_color import color_offset

    assert lens.axial_color is not None
    if isinstance(lens.blur, float):
        red, blue = (-share * lens.blur for share in lens.axial_color)
        return red, blue
    thin_lens = thin_lens_of(lens, size)
    red, blue = (float(color_offset(thin_lens, shift)) for shift in lens.axial_color)
    return red, blue


def thin_lens_of(lens: LensValues, size: tuple[int, int]) -> ThinLens:
    """The `ThinLens` with the values of `lens`, for pictures of ``size`` (width, height) px."""
    import torch

    from defocus_core.optics.thin_lens import ThinLens

    width, height = size
    sensor = (lens.sensor_width, lens.sensor_width * height / width)
    try:
        thin_lens = ThinLens(lens.foclen, lens.fnum, sensor, (width, height), "cpu", torch.float64)
        thin_lens.refocus(math.inf if lens.foc_dist is None else lens.foc_dist)
        thin_lens.sharp_range = lens.sharp_range
    except ValueError as error:
        option = lens.focus_source.with_field("focus")
        remedy = "check the lens options"
        raise UsageProblem("out-of-range", reason(error), remedy, path=option) from error
    return thin_lens


def _refuse_infinite(
    radius: NDArray[np.float32], fnum: float, metres: NDArray[np.float32], path: Path | None = None
) -> None:
    """Raise an error if a radius is not finite; `path` is the depth file, if any."""
    if (finite := np.isfinite(radius)).all():
        return
    if path is not None and (nearest := float(metres[~finite].min())) < _NEAREST:
        problem = f"has a depth of {nearest:.3g} m, whose blur is infinite"
        raise InputError("too-blurred", problem, "check ‹depth-unit› and ‹focus›", path=path)
    problem = f"f/{fnum:g} makes the blur of this picture infinite"
    remedy = "check the lens options and the depth's unit"
    raise UsageProblem("out-of-range", problem, remedy, field="fnumber")


def _limits_of(px: Any, depth: Depth) -> tuple[float, float]:
    """The least and the greatest radius in px, except of empty pixels; refuses huge radii."""
    radius = px if depth.empty is None else px[~depth.empty]
    radius = radius[np.isfinite(radius)] if depth.is_radius else radius
    least, greatest = (float(radius.min()), float(radius.max())) if radius.size else (0.0, 0.0)
    remedy = "check ‹depth-unit› and ‹focus›"
    if depth.is_radius and not depth.is_relative and max(-least, greatest) > _MAX_PX:
        problem = f"has a CoC radius of {max(-least, greatest):.2g} px"
        remedy = "check ‹depth-format› coc"
    elif not depth.is_radius and not -least <= _MAX_PX:
        nearest, _ = depth.ends or (0.0, 0.0)
        problem = f"has a depth of {nearest:.3g} m, which is blurred by {-least:.2g} px"
    elif not depth.is_radius and not greatest <= _FARTHEST_PX:
        problem = (
            f"is blurred by {greatest:.2g} px: the focus is hardly farther than the focal length"
        )
        raise InputError("out-of-range", problem, "focus farther away", path=depth.path)
    else:
        return least, greatest
    raise InputError("too-blurred", problem, remedy, path=depth.path)


# Nothing is in focus if the CoC radius of the sharpest pixel exceeds both of these.
SHARP_PX = 2.0  # px
SHARP_SHARE = 0.25  # of the greatest CoC radius
_BLACK_IS_NEAR = -0.3  # evidence of the near end, -2 to 2
_UNREAL = ("worlddepth", "scenedepth", "imagedepth")  # channels that Unreal writes, in centimetres
_HYPERSIM = "dataset"  # array of its HDF5 files


def doubt_depth(take: Take) -> Take:
    """Warn if depth seems to have another unit or meaning than assumed."""
    reading, depth, own = take.job.reading, take.inputs.depth, take.radii
    words = [
        *of_radii(depth, own.px, own.limits, take.lens, declared=reading.says_scale),
        *of_file(depth, declared=reading.says_scale),
    ]
    if depth.is_relative and reading.invert is None:
        words += of_near_end(depth)
    return replace(take, warnings=(*take.warnings, *words))


def of_near_end(depth: Depth) -> Iterator[str]:
    """Yield a warning if near pixels of relative depth seem black, but white is taken as near."""
    from defocus_core.picture.subject import white_is_near

    if white_is_near(depth) < _BLACK_IS_NEAR:
        why = "by the bottom and the middle of the picture black is near"
        yield f"{depth.path.name}: {why}, but white is taken as near; give ‹invert›, or ‹no-invert›"


def of_radii(
    depth: Depth, radius: Any, limits: tuple[float, float], lens: LensValues, *, declared: bool
) -> Iterator[str]:
    """Yield at most one warning if blur radii are implausible, such as nothing in focus.

    `radius` are the signed radii [H, W] px, `limits` the least and the greatest. `declared` tells
    whether the user gave format or unit of the depth, for the remedy.
    """
    greatest = max(abs(end) for end in limits)
    if depth.is_relative and lens.focus_value is not None:
        number, ends = lens.focus_value, depth.ends
        unsharp = _least_blur(radius, greatest)
        if ends and (unsharp or not ends[0] <= number <= ends[1]):
            numbers = f"numbers go from {ends[0]:.6g} to {ends[1]:.6g}"
            nothing = f"nothing is in focus at the number {number:g}: {numbers}"
            yield f"{', '.join(filter(None, (nothing, unsharp)))}; check ‹focus-value›"
        return
    if lens.foc_dist is None:
        return
    height, width = depth.metres.shape
    remedy = f"check {'the declared format or unit' if declared else '‹depth-unit›'} and ‹focus›"
    nearer = int(np.count_nonzero(depth.metres * MM_PER_M < lens.foclen))
    if nearer:
        where = f"nearer than the focal length {length_text(lens.foclen)}"
        yield f"depth is {where} in {counted(nearer, 'pixel')}; {remedy}"
    elif 2 * greatest > max(width, height):
        blur = f"a blur {2 * greatest:.3g} px wide, wider than the picture"
        yield f"depth goes {_range_text(depth)}, which gives {blur}; {remedy}"
    elif unsharp := _least_blur(radius, greatest):
        nothing = f"nothing is in focus at {length_text(lens.foc_dist)}"
        yield f"{nothing}: depth goes {_range_text(depth)}, {unsharp}; {remedy}"


def _least_blur(radius: Any, greatest: float) -> str:
    """A note with the radius of the sharpest pixel if nothing is in focus; else empty.

    `greatest` is the greatest radius in px.
    """
    if greatest <= SHARP_PX:
        return ""
    sharpest = float(np.abs(radius).min())
    is_sharp = sharpest <= max(SHARP_PX, SHARP_SHARE * greatest)
    return "" if is_sharp else f"the sharpest pixel has a CoC radius of {sharpest:.3g} px"


def _range_text(depth: Depth) -> str:
    """The range of depth without sky as text, like ``from 2m to 40m``."""
    nearest = float(depth.metres.min())
    farthest = float(np.max(depth.metres, where=np.isfinite(depth.metres), initial=0.0))
    if math.isinf(nearest):
        return "nowhere but to the sky"
    near, far = (length_text(float(f"{x * MM_PER_M:.3g}")) for x in (nearest, farthest))
    return f"from {near} to {far}"


def of_file(depth: Depth, *, declared: bool) -> Iterator[str]:
    """Yield warnings if name or channel of a depth file suggest another format than assumed.

    Nothing is yielded if the user declared the format.
    """
    if declared:
        return
    path, channel = depth.path, depth.channel.lower()
    if path.suffix.lower() == ".pfm" and (path.parent / "calib.txt").is_file():
        problem = "calib.txt beside it tells of disparity, but depth is taken as metres"
        yield f"{path}: {problem}; give ‹depth-format› middlebury, or metres"
    if any(word in channel for word in _UNREAL):
        problem = f"channel {depth.channel} is one that Unreal writes in centimetres"
        yield f"{path}: {problem}, but depth is taken as metres; give ‹depth-format› unreal-mrq"
    if "mist" in channel:
        problem = f"channel {depth.channel} is a fog of 0 to 1 by distance, and no depth"
        yield f"{path}: {problem}; render the pass Z, and give ‹depth-channel›"
    if "vrayzdepth" in channel and (depth.ends or (0.0, 2.0))[1] <= 1:
        problem = f"channel {depth.channel} lies within 0 and 1, as V-Ray maps black to white"
        yield f"{path}: {problem}; give ‹depth-format› vray-zdepth with its ‹depth-range›"
    if channel == _HYPERSIM and path.suffix.lower() in (".hdf5", ".h5"):
        problem = "array dataset is that of Hypersim, whose numbers are distances to the point"
        yield f"{path}: {problem}; give ‹depth-format› hypersim, or metres"
