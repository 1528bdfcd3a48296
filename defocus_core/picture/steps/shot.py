"""Frames of a shot: what they decide together, and what neighbours of a frame have seen.

How depth is repaired and where the focus lies are decided by a sample of the frames, so that no
frame decides for itself and flickers. Every process finds them anew, from the same files to the
same result. The depth of a frame is averaged with that of its neighbours.

Motion vectors of an EXR say where the surface of each pixel is in the frames before and after.
Blender's pass has channels X, Y, Z and W: the place in the frame before less the place in this one,
and the place in this frame less the one after, in px, y upwards (Cycles' kernel). Nuke's layers
``forward`` and ``backward`` have u and v: the place in the other frame less the one in this, v
upwards. Without vectors to the frame before, a surface moves on as it did.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from statistics import median
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import DefocusError, InputError, TooLarge, UsageProblem
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.images.color import Color
from defocus_core.io.safe_files import read_head
from defocus_core.io.shots.frame_patterns import in_words
from defocus_core.picture.focus import with_blur_reach, with_focus
from defocus_core.picture.memory_budget import capacity_mb, holding
from defocus_core.picture.pair import read, reframe
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import map_windows, windows
from defocus_core.picture.take import InputPair, Take
from defocus_core.request.job import FrameLens, Job, Reading, Shot
from defocus_core.request.lens import Lens
from defocus_core.request.shots import AVERAGED
from defocus_core.system import memory

if TYPE_CHECKING:
    import torch

    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
    from defocus_core.sequences.neighbours import Frame


_KEPT = 1 << 12  # foci of frames
_REPAIRS: dict[object, DepthRepair] = {}


def lens(take: Take) -> Take:
    """The take with the focus that the frames of its shot decide together, if they do."""
    return replace(take, lens=_with_shared_focus(take.job, take.inputs.depth))


def radii(take: Take) -> Take:
    """The take with the repair that the frames of its shot decide on, if they do."""
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.sequences.shot_repair import agreed_repair, repair_through

    job, own = take.job, take.radii
    assert job.shot is not None
    key = (job.shot.sample, job.reading)
    if key not in _REPAIRS:
        _REPAIRS.clear()
        each = [_repair_of(frame, job) for frame in job.shot.sample]
        _REPAIRS[key] = agreed_repair([r for r, _ in each], [scale for _, scale in each])
    decided = repair_through(_REPAIRS[key], own.scale, own.infinity)
    note = "" if decided == DepthRepair() else _words(job.shot)
    return replace(take, decided=decided, shot_note=note)


def _with_shared_focus(job: Job, depth: Depth) -> Lens:
    """The lens of a job with its focus distance."""
    shot, lens = job.shot, job.lens
    frames = () if shot is None else shot.focus or shot.sample
    by_depth = lens.focus_at is not None or lens.focus_percentile is not None
    # Numbers of a blur in px may be of another scale in each frame
    if not frames or lens.draw is not None or lens.blur is not None or not by_depth:
        return with_focus(lens, depth)
    found = replace(lens, foc_dist=_mean_focus(frames, job), focus_at=None, focus_percentile=None)
    within = with_focus(found, depth)
    return replace(within, focus_at=lens.focus_at, focus_percentile=lens.focus_percentile)


def _mean_focus(frames: Sequence[FrameLens], job: Job) -> float:
    """The mean focus in mm of frames, in disparity, of those that have something to focus on."""
    distances, failed = [], []
    for frame in frames:
        try:
            distances.append(_own_focus(frame, job.reading, *_keeping_and_focal(frame, job)))
        except DefocusError as error:
            failed.append(error)
    if not distances:
        raise failed[0]
    disparity = [1 / each for each in distances]
    of_sample = job.shot is not None and not job.shot.focus
    # of a sample a frame that is unlike others counts less
    mean = median(disparity) if of_sample else sum(disparity) / len(disparity)
    return 1 / mean if mean else float("inf")


@lru_cache(maxsize=_KEPT)
def _own_focus(
    frame: FrameLens, reading: Reading, keeping: Keeping, lens_focal: float | None
) -> float:
    """The focus in mm that the depth of a frame decides."""
    _, depth = read(InputPair(frame.picture, reading, keeping, lens_focal))
    foc_dist = with_focus(replace(frame.lens, max_coc=None), depth).foc_dist
    return float("inf") if foc_dist is None else foc_dist


def _keeping_and_focal(frame: FrameLens, job: Job) -> tuple[Keeping, float | None]:
    """Where the arrays of a frame are kept, and the focal length in widths of its sensor."""
    return holding(job).keeping, replace(job, lens=frame.lens).lens_focal


def _repair_of(frame: FrameLens, job: Job) -> tuple[DepthRepair, float]:
    """The repair that a frame needs, and the scale of its lens."""
    import torch

    from defocus_core.depth.repair import repair_depth

    color, depth = read(InputPair(frame.picture, job.reading, *_keeping_and_focal(frame, job)))
    of_frame = replace(job, picture=frame.picture, lens=frame.lens)
    lens = with_blur_reach(_with_shared_focus(of_frame, depth), (depth,))
    own = radii_of(lens, depth, holding(job).keeping)
    _, repair = repair_depth(
        map_windows(own.px, "cpu"),
        windows(color.planes, "cpu"),
        own.infinity,
        torch.get_num_threads(),
        depth_repair=job.reading.depth_repair,
        edge_width=job.reading.edge_width,
    )
    return repair, own.scale


@lru_cache(maxsize=8)
def _words(shot: Shot) -> str:
    """The frames that decided on a repair, in words."""
    numbers = [int(each.picture.frame or 0) for each in shot.sample]
    return f"as {in_words(numbers)} of the shot decide"


_FORWARD, _BACKWARD = "forward", "backward"


class Motion(NamedTuple):
    """Vectors [2, H, W] in px, right and down, from each pixel to its surface's other places."""

    to_previous: NDArray[np.float32]
    to_next: NDArray[np.float32]


def read_motion(files: Iterable[Path], channel: str, overscan: Overscan = NO_OVERSCAN) -> Motion:
    """The motion of a frame."""
    names: list[str] = []
    for path in dict.fromkeys(files):
        if not is_exr(read_head(path)):
            continue
        there = [c.name for header in read_headers(path) for c in header.channels]
        if vectors := _vectors(there, channel):
            planes = _planes(path, {name for x, y, _ in vectors for name in (x, y)}, overscan)
            to_next, *to_previous = (
                np.stack([sign * planes[x], -sign * planes[y]]) for x, y, sign in vectors
            )
            return Motion(to_previous[0] if to_previous else -to_next, to_next)
        names += there
    layers = ", ".join(sorted({name.rpartition(".")[0] for name in names} - {""})) or "none"
    problem = f"has no motion vectors '{channel}'"
    remedy = f"its layers are {layers}; name one with ‹motion›"
    raise InputError("no-such-channel", problem, remedy, path=path)


def _planes(path: Path, names: set[str], overscan: Overscan) -> dict[str, NDArray[np.float32]]:
    parts = read_parts(path, wanted=lambda _, name: name in names, overscan=overscan)
    return {name: plane[:].astype("f4") for part in parts for name, plane in part.channels.items()}


def _vectors(names: list[str], channel: str) -> list[tuple[str, str, float]]:
    """The channels of x and y to the frame after, and to the one before, and their signs."""
    by_lower = {name.lower(): name for name in names}
    layer = channel.lower().removesuffix(".")
    stem = layer.removesuffix(_FORWARD).removesuffix(_BACKWARD)

    def pair(of_layer: str, ends: str, sign: float = 1.0) -> list[tuple[str, str, float]]:
        x, y = (by_lower.get(f"{of_layer}.{end}") for end in ends)
        return [(x, y, sign)] if x and y else []

    blender = pair(layer, "zw", -1.0) + pair(layer, "xy")
    if len(blender) == 2:
        return blender
    after = pair(layer if stem == layer else f"{stem}{_FORWARD}", "uv")
    before = [] if stem == layer else pair(f"{stem}{_BACKWARD}", "uv")
    return after and after + before


# Rows beside a band that decide its means; share of the memory that decoded neighbours may take;
# change of radius in px, from a frame to the next, of one surface; most frames that are kept.
_BESIDE, _SHARE, _STEP, _MAX_KEPT = 4, 0.1, 0.5, 40
# Distances in frames of the neighbours that may show what is hidden: in a moving shot the nearest
# show it best, and each farther one shows more; of those between there is little more to see.
_DISTANCES = frozenset({1, 3, 6, 10})


def blur(take: Take) -> Take:
    """The take with radii averaged over frames, and what neighbours have seen of what is hidden."""
    shot = take.job.shot
    assert shot is not None
    if take.inputs.layers is not None and shot.motion is not None:
        problem = "has no effect: layers, of deep pixels or of a plate, hold what is hidden"
        raise UsageProblem("idle-option", problem, "leave it out", field="motion")
    noise = None if take.decided is None else take.decided.noise
    if noise is None and shot.motion is None:
        return take
    if shot.motion is not None and take.inputs.holding.scratch:
        problem = "is too large for ‹motion› in the memory that is allowed"
        remedy = "allow more ‹memory›, or leave out ‹motion›"
        raise TooLarge("out-of-memory", problem, remedy, path=take.job.picture.color)
    neighbours = Neighbours(take)
    if noise is not None:
        averaged = neighbours.averaged_radius(noise)
        count = min(len(shot.neighbours), AVERAGED)
        note = f"averaged over {count} frames where the scene is still"
        take = replace(
            take, shot_note=f"{note}, {take.shot_note}", blur=take.blur._replace(px=averaged)
        )
    if shot.motion is not None:
        take = replace(take, seen=neighbours.hidden(take.blur.px))
    return take


class Neighbours:
    """The neighbours of a frame, decoded when they are needed; neighbours of the last are kept."""

    def __init__(self, take: Take) -> None:
        """Keep what the neighbours are read with."""
        job, inputs = take.job, take.inputs
        assert job.shot is not None
        self._job, self._inputs, self._lens, self._shot = job, inputs, take.lens, job.shot
        self._neighbours = job.shot.neighbours
        self._place = [picture.frame for picture in self._neighbours].index(job.picture.frame)
        self._radii = {self._place: take.radii.px}
        others = (place for place in range(len(self._neighbours)) if place != self._place)
        self._order = sorted(others, key=lambda place: (abs(place - self._place), place))

    def averaged_radius(self, noise: float) -> Any:
        """Radii [H, W] px averaged with those of the neighbours where the scene is still."""
        import torch

        from defocus_core.sequences.neighbours import Frame, temporal_mean

        radius = self._radii[self._place]
        averaged = self._inputs.holding.keeping.new(radius.shape, "float32")
        moves = self._shot.motion is not None
        others = [
            (
                self._files(place),
                self._radius(place),
                self._path(self._place, place) if moves else None,
            )
            for place in self._order[: AVERAGED - 1]
        ]
        parts = [slice(0, radius.shape[0])] if moves else bands(radius.shape)
        for rows in parts:
            top = max(rows.start - _BESIDE, 0)
            around = slice(top, rows.stop + _BESIDE)
            frames = (
                Frame(_image(color, around), torch.from_numpy(px[around]), motion)
                for (color, _), px, motion in ((self._files(self._place), radius, None), *others)
            )
            mean, _ = temporal_mean(next(frames), frames, noise)
            averaged[rows] = mean[rows.start - top : rows.stop - top].numpy()
        return averaged

    def hidden(self, radius: Any) -> HiddenLayer:
        """What neighbours have seen behind surfaces of radii [H, W] px, the closest first."""
        import torch

        from defocus_core.sequences.neighbours import Frame, seen_behind

        def frame(place: int, px: Any, motion: torch.Tensor | None = None) -> Frame:
            image = _image(self._files(place)[0], slice(None))
            return Frame(image, torch.from_numpy(px[:]), motion)

        shown = (p for p in self._order if abs(p - self._place) in _DISTANCES)
        moved = (frame(p, self._radius(p), self._path(p, self._place)) for p in shown)
        return seen_behind(frame(self._place, radius), moved)

    def _path(self, start: int, end: int) -> torch.Tensor:
        """The motion [2, H, W] px from one frame of the window to another."""
        import torch

        from defocus_core.sequences.neighbours import chained

        way = range(start, end, 1 if end > start else -1)
        motions = [self._motion(place)[end > start] for place in way]
        radii = [torch.from_numpy(self._radius(place)[:]) for place in way]
        return chained([torch.from_numpy(each) for each in motions], radii, _STEP)

    def _motion(self, place: int) -> Motion:
        picture = self._neighbours[place]
        channel = self._shot.motion
        assert channel is not None
        files, color = (picture.color, picture.depth), self._decode(place)[0]
        motion: Motion = _CACHE.kept(
            ("motion", picture, channel, color.overscan),
            lambda: read_motion(files, channel, color.overscan),
            self._max_mb(),
        )
        wanted = self._inputs.color.overscan
        if color.overscan != wanted:
            still = None if color.alpha is None else 0.0
            pairs = (
                [reframe(plane, color.overscan, wanted, still)[:] for plane in vectors]
                for vectors in motion
            )
            motion = Motion(*map(np.stack, pairs))
        if motion.to_next.shape[1:] != self._inputs.depth.metres.shape:
            problem = "has motion vectors of another size"
            raise InputError("wrong-size", problem, "render it again", path=picture.color)
        return motion

    def _radius(self, place: int) -> Any:
        """The radii of a frame of the window through the lens of the frame."""
        if place not in self._radii:
            keeping = self._inputs.holding.keeping
            self._radii[place] = radii_of(self._lens, self._files(place)[1], keeping).px
        return self._radii[place]

    def _decode(self, place: int) -> tuple[Color, Depth]:
        """Colour and depth of a frame of the window, with its own overscan."""
        if place == self._place:
            return self._inputs.color, self._inputs.depth
        picture, keeping = self._neighbours[place], self._inputs.holding.keeping
        both: tuple[Color, Depth] = _CACHE.kept(
            (picture, self._job.reading, self._job.lens_focal),
            lambda: read(InputPair(picture, self._job.reading, keeping, self._job.lens_focal)),
            self._max_mb(),
        )
        return both

    def _files(self, place: int) -> tuple[Color, Depth]:
        """Colour and depth of a frame of the window, with the overscan of the frame.

        Beyond its own there is nothing of an element; other pictures go on as at their edge.
        """
        picture, (color, depth) = self._neighbours[place], self._decode(place)
        own, wanted = color.overscan, self._inputs.color.overscan
        if own != wanted:
            dark, far = (None, None) if color.alpha is None else (0.0, np.inf)
            far = 0.0 if far is not None and depth.is_radius else far
            planes = tuple(reframe(plane, own, wanted, dark) for plane in color.planes)
            color = replace(color, planes=planes, overscan=wanted)
            metres = reframe(depth.metres, own, wanted, far)
            depth = replace(depth, metres=metres, overscan=wanted, empty=None)
        if color.shape != self._inputs.color.shape:
            height, width, channels = color.shape
            unlike = self._inputs.color.path
            problem = f"is {width}x{height} px of {channels} channels, unlike {unlike}"
            needless = "leave out ‹motion›" if self._shot.motion else "‹no-steady›"
            remedy = f"give frames of one size, or {needless}"
            raise InputError("wrong-size", problem, remedy, path=picture.color)
        return color, depth

    def _max_mb(self) -> float:
        return _SHARE * capacity_mb(self._job.machine)


class _Cache:
    """What was decoded of frames of a shot, as long as it fits; the oldest goes first."""

    def __init__(self) -> None:
        self._kept: OrderedDict[object, Any] = OrderedDict()
        self._lock = Lock()  # jobs of one process may run in several threads

    def kept(self, key: object, make: Any, max_mb: float) -> Any:
        """The value of a key, made if it is not there."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        value = make()
        with self._lock:
            self._kept[key] = value
            while len(self._kept) > 1 and (
                len(self._kept) > _MAX_KEPT or sum(map(_size_mb, self._kept.values())) > max_mb
            ):
                self._kept.popitem(last=False)
        return value


_CACHE = _Cache()


def _size_mb(value: Any) -> float:
    if isinstance(value, Motion):
        return float(value.to_next.nbytes + value.to_previous.nbytes) / memory.MB
    color, depth = value
    planes = (*color.planes, *color.extras.values(), depth.metres)
    return sum(getattr(plane, "nbytes", 0) for plane in planes) / memory.MB


def _image(color: Color, rows: slice) -> torch.Tensor:
    """The colours [C, h, W] of some rows."""
    import torch

    return torch.from_numpy(np.stack([plane[rows] for plane in color.planes]).astype(np.float32))
