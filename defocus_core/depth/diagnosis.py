"""What a first look over a picture tells: its ranges, and how steep and how bright it is."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.antialiased import EVERY, averaged_from, averages
from defocus_core.depth.quantised import Levels, are_few, levels_of
from defocus_core.depth.ramps import STEEP, are_steeper, steepness
from defocus_core.depth.repair import Mending, denoised
from defocus_core.depth.soft_edges import LEAST, hard_steps, slope_of_soft_edges, softness
from defocus_core.images.neighbourhoods import ends_of
from defocus_core.images.source import Pixels, bands, spread
from defocus_core.runtime.threads import threaded

# Share of a frame that edges may be: what is steep nearly everywhere is a surface.
_EDGES = 0.25
# Hard edges to a pixel on a ramp that make a surface of this one.
_RARE = 16
# Every how many rows and columns a pixel is looked at where some will do, and every how many rows
# from either end of the frame.
_SOME, _SOME_ROWS = 3, 12


class _Depth(NamedTuple):
    """What some rows of a picture tell of its depth.

    Attributes:
        ends: [4] least and greatest radius, greatest steps down and across.
        softest: Slope in px per px of the steepest soft edge.
        ramps: How many pixels lie on steep ramps, wide or not.
        levels: Of depth.
        averages: [2, 4], see there.
    """

    ends: Tensor
    softest: Tensor
    ramps: Tensor
    levels: Levels
    averages: Tensor


def mending_of(
    signed_radius: Pixels, dtype: torch.dtype, threads: int, infinity: float | None = None
) -> Mending:
    """What depth needs; the arguments are those of `survey`."""
    height, width = signed_radius.shape

    def looked_at(rows: tuple[int, int]) -> _Depth:
        return _depth_of(signed_radius, rows, dtype, infinity)

    told = list(threaded(looked_at, bands(height, width), threads))
    return _mending(signed_radius, told, infinity)


def depth_mending(
    signed_radius: Tensor, infinity: float | None = None, threads: int = 1
) -> Mending:
    """What would be mended of depth before it is rendered.

    Args:
        signed_radius: [H, W] px.
        infinity: As for `render`.
        threads: To compute with.
    """
    quiet, noise = denoised(signed_radius, threads, hold=True)
    return mending_of(quiet, signed_radius.dtype, threads, infinity)._replace(noise=noise)


def _depth_of(
    signed_radius: Pixels, rows: tuple[int, int], dtype: torch.dtype, infinity: float | None
) -> _Depth:
    """What a band tells, from its first row to before the end."""
    H, W = signed_radius.shape
    above = min(rows[0], 2)
    around = signed_radius[rows[0] - above : rows[1] + 2].detach().to(dtype)
    below = around[above : above + rows[1] + 1 - rows[0]]
    r = below[: rows[1] - rows[0]]
    steps = [around.diff(dim=dim) for dim in (0, 1)]
    most = [float(ends_of(s).abs().amax()) if s.numel() else 0.0 for s in steps]
    ends = torch.cat([ends_of(r), r.new_tensor(most)])
    softest, averaged = ends.new_zeros(()), ends.new_zeros((2, 4), dtype=torch.float64)
    ramps = torch.zeros((), dtype=torch.long, device=r.device)
    if max(most) > LEAST:
        if any(are_steeper(step, dim, LEAST) for dim, step in enumerate(steps)):
            slope = steepness(around)
            softest = softness(slope)[above : above + len(r)].amax()
            ramps = (slope[above : above + len(r)] > STEEP).sum()
        averaged = averages(r, spread(H, EVERY, *rows), spread(W, EVERY), infinity)
    some = spread(H, _SOME_ROWS, *rows)
    levels = levels_of(r[some], below[1:][[i for i in some if i + 1 < len(below)]])
    return _Depth(ends, softest, ramps, levels, averaged)


def _mending(signed_radius: Pixels, told: list[_Depth], infinity: float | None) -> Mending:
    """What all bands together need."""
    ends = torch.stack([depth.ends for depth in told])
    softest = float(torch.stack([depth.softest for depth in told]).amax())
    ramps = torch.stack([depth.ramps for depth in told]).sum()
    soft_edges = slope_of_soft_edges(float(ends[:, 0].amin()), float(ends[:, 1].amax()))
    soft = _mostly_soft(signed_radius, soft_edges) if softest > soft_edges else 0
    averaged = torch.stack([depth.averages for depth in told]).sum(0)
    antialiased = averaged_from(averaged, infinity, soft)
    return Mending(
        antialiased=antialiased,
        ramps=softest > STEEP or _has_ramps(signed_radius, int(ramps)),
        soft_edges=soft_edges if soft and antialiased is None else None,
        terraces=are_few([depth.levels for depth in told]),
    )


def _has_ramps(signed_radius: Pixels, pixels: int) -> bool:
    """Whether pixels on steep ramps, of which there are some, stand for edges.

    A few among many hard edges are surfaces, seen where they pass between two others.
    """
    hard, enough = 0, _RARE * pixels
    for first, last in bands(*signed_radius.shape):
        if hard <= enough and pixels:
            around = signed_radius[max(0, first - 1) : last + 2]
            hard += int(hard_steps(around, STEEP))
    return pixels > 0 and hard <= enough


def _mostly_soft(signed_radius: Pixels, steep: float) -> int:
    """How many pixels of a frame lie on soft edges of some slope; 0 if more are beside hard ones.

    Or if they lie on a surface that is as steep: in a frame of few px each surface is.
    """
    soft = hard = 0
    for first, last in bands(*signed_radius.shape):
        above = min(first, 2)
        around = signed_radius[first - above : last + 2].detach()
        soft += int((softness(steepness(around))[above : above + last - first] > steep).sum())
        hard += int(hard_steps(around, steep))
    height, width = signed_radius.shape
    return soft if hard < soft < _EDGES * height * width else 0
