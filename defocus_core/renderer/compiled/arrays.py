"""Rendering of pictures that are NumPy arrays, by compiled loops without torch."""

from __future__ import annotations

import math
import mmap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.depth.ramps import reduction
from defocus_core.renderer.compiled import back
from defocus_core.renderer.compiled.back import Samples
from defocus_core.renderer.compiled.bands import Bounds
from defocus_core.renderer.compiled.carried import CHANNELS
from defocus_core.renderer.compiled.hidden import hidden_of
from defocus_core.renderer.compiled.look import DepthLook, look_at_depth, look_at_light
from defocus_core.renderer.compiled.mixed import set_light, split_mixed
from defocus_core.renderer.compiled.openings import left_share
from defocus_core.renderer.compiled.shifts import may_be_shifted
from defocus_core.renderer.engine.limits import NEGLIGIBLE, OVERSHOOT, SLACK
from defocus_core.renderer.engine.settings import quality_of
from defocus_core.renderer.inpainting.disocclusion import EDGE
from defocus_core.renderer.layers.slice_radii import SHARP, plane_of

if TYPE_CHECKING:
    from defocus_core.renderer.engine.settings import Settings

# Greatest radius in px at the border for which any frame is continued by the reach of light; for
# others it is continued by its side. Light reaches at most _REACH times its radius plus _MORE px.
_WIDEST, _REACH, _MORE = 40.0, 2.05, 8.0
_MANY = 1 << 22  # size of arrays, in numbers, above which small pages save memory
NO_LIGHTS = np.zeros((3, CHANNELS, 1, 0), np.float32)


class Statistics(NamedTuple):
    """Statistics of a picture that its rendering needs; fields are as in `engine.frame.Content`."""

    limits: tuple[float, float]  # least and greatest signed radius, px
    edges: bool  # whether surfaces hide others
    minimum: float  # least light; 0 unless pixels are negative
    channels: tuple[tuple[float, float], ...]  # least and greatest value of each channel
    limit: float  # greatest light

    @property
    def unit(self) -> float:
        """A power of 2 by which light is divided, so that its squares fit into float32."""
        return 2.0 ** math.floor(math.log2(self.limit)) if self.limit > 0 else 1.0


class ArrayViews(NamedTuple):
    """The views of a picture, as arrays."""

    images: NDArray[np.float32]  # [1 or 3, C, H, W] centre, left and right
    trust: NDArray[np.float32]  # [1, H, W]
    stats: dict[str, int]  # counts, as of `ViewTensors`


def look_at(radius: NDArray[np.float32]) -> DepthLook:
    """Statistics of signed radii [H, W] in px, and whether the depth needs no repair."""
    return DepthLook(*look_at_depth(radius, reduction(radius.shape)))


def is_clean(image: NDArray[np.float32], radius: NDArray[np.float32], seen: DepthLook) -> bool:
    """Whether the depth of a picture [C, H, W] certainly needs no repair.

    `radius`: signed radii [H, W] px; `seen`: their statistics.
    """
    if not seen.clean or seen.step <= seen.hard:
        return seen.clean
    return len(image) == CHANNELS and not may_be_shifted(image, radius, np.float32(seen.hard))


def rendered_alone(
    image: NDArray[Any], radius: NDArray[np.float32], settings: Settings
) -> ArrayViews | None:
    """The views of a picture [3, H, W] with signed radii [H, W] px; None if torch is needed.

    The settings must be supported, see `carries_settings`.
    """
    seen, is_exact = look_at(radius), settings.depth_repair == "off"
    if not seen.usable or not (is_exact or seen.clean):
        return None
    if plane_of(*seen.range) is not None or _is_cut(radius):
        return None
    image = np.ascontiguousarray(image, np.float32)
    each, plain = look_at_light(image)
    if not plain or not (is_exact or is_clean(image, radius, seen)):
        return None
    channels = tuple((least, greatest) for least, greatest in each.tolist())
    statistics = Statistics(
        limits=seen.range,
        edges=seen.step > EDGE,
        minimum=min(0.0, *(least for least, _ in channels)),
        channels=channels,
        limit=max(0.0, *(greatest for _, greatest in channels)),
    )
    samples = samples_of(image, radius, statistics)
    found, darker = render_samples(samples, NO_LIGHTS, statistics, settings, slice(0, CHANNELS))
    return ArrayViews(found[:, :-1], found[0, -1:], counts_of(radius, darker, settings))


def _is_cut(radius: NDArray[np.float32]) -> bool:
    """Whether blur at the border of the frame reaches farther than the frame is continued.

    `radius`: signed radii [H, W] px.
    """
    border = radius[:1], radius[-1:], radius[:, :1], radius[:, -1:]
    widest = max(float(np.abs(line).max()) for line in border)
    return widest > _WIDEST and _REACH * widest + _MORE > min(radius.shape)


def render_samples(
    samples: Samples,
    lights: NDArray[np.float32],
    statistics: Statistics,
    settings: Settings,
    channels: slice,
) -> tuple[NDArray[np.float32], int]:
    """The views [1 or 3, C + 1, H, W] of `channels`, and the number of negative pixels.

    A view holds the C colours and then the trust. `lights`: as for `back.render`.
    """
    bounds = _bounds(statistics, channels.stop, settings)
    found, darker = back.render(
        samples,
        lights[: 3 if settings.left_right else 1],
        bounds._replace(range=bounds.range[channels]),
        outline=settings.aperture.fixed.outline,
        min_slope=quality_of(settings.quality).min_slope,
        edges=statistics.edges,
        threads=settings.threads,
    )
    found[:, :-1] *= np.float32(statistics.unit)
    return found, darker


def counts_of(radius: NDArray[np.float32], darker: int, settings: Settings) -> dict[str, int]:
    """The counts of `ViewTensors.stats` for a rendered picture.

    `radius`: signed radii [H, W] px; `darker`: number of pixels of left or right that were
    negative.
    """
    in_focus = int(np.count_nonzero(np.abs(radius) <= SHARP))
    counts = {"pixels": radius.size, "pixels_copied": in_focus, "tiles": 1}
    return counts | ({"pixels_clamped": darker} if settings.left_right else {})


def samples_of(
    image: NDArray[np.float32], radius: NDArray[np.float32], statistics: Statistics
) -> Samples:
    """The surfaces of a picture [3, H, W] without highlights, with signed radii [H, W] px."""
    unit, edges = statistics.unit, statistics.edges
    light = _zeros((1 + edges, radius.shape[0], 4 * radius.shape[1]))
    scale, limit = np.float32(1 / unit), statistics.limit / unit
    set_light(image, scale, light[0])
    radii = radius[None]
    if edges:
        radii = _zeros((2, *radius.shape))
        radii[0] = radius
        if not split_mixed((image, scale, np.float32(limit), radius), light, radii):
            light, radii = light[:1], radii[:1]
    samples = Samples(light, radii, statistics.limits)
    return samples._replace(hidden=hidden_of(samples, limit)) if edges else samples


def _zeros(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Zeros in small memory pages, allocated when they are written; NumPy allocates huge pages."""
    if math.prod(shape) < _MANY:
        return np.zeros(shape, np.float32)
    private = getattr(mmap, "MAP_PRIVATE", 0) | getattr(mmap, "MAP_ANONYMOUS", 0)
    pages = mmap.mmap(-1, 4 * math.prod(shape), **({"flags": private} if private else {}))
    return np.frombuffer(pages, np.float32).reshape(shape)


def _bounds(statistics: Statistics, count: int, settings: Settings) -> Bounds:
    """The limits of the values of rendered views with `count` channels."""
    unit, known = statistics.unit, statistics.channels[:count]
    others = [(statistics.minimum, math.inf)] * (count - len(known))
    least, greatest = np.array([*known, *others]).T / unit
    slack = [SLACK * np.minimum(np.abs(x), greatest - least) for x in (least, greatest)]
    more = OVERSHOOT * (greatest - least)
    limits = least - slack[0], greatest + slack[1], least - more, greatest + more
    negative = (statistics.minimum - NEGLIGIBLE * statistics.limit) / unit
    return Bounds(
        range=np.stack(limits, 1).astype(np.float32),
        minimum=statistics.minimum / unit,
        negative=negative,
        left=left_share(settings.aperture.fixed.outline),
        apart=float(settings.dual_pixel.separation),
    )
