"""Displacements of depth edges from those of the colours, and their correction.

Estimated depth has edges that lie some px outside or inside those of the subject: beside a sharp
subject a strip of the background would stay sharp, or the subject's own rim would be blurred. The
colours of both surfaces are sampled some px away from the silhouette, which is the pixels on the
nearer side of an edge, and are described by normal distributions along it. The cost of a
displacement is the number of pixels across the silhouette that it would leave on the wrong side.
The costs of each displacement are averaged along the silhouette before the least is chosen, so that
the result is smooth (as in stereo, Hosni et al. 2013); the choice is soft, so that small changes of
the costs change it little (Kendall et al. 2017). A displacement that is rare in the picture needs
more evidence, and so does one that differs by more than a px from those of a longer part of the
silhouette: where colours decide little, a pixel gets the displacement of its neighbours (one round
of a mean field; Krähenbühl and Koltun 2011).

How well colours decide is tested on pixels whose side is known, farther from the edge than those
sampled: with similar textures on both sides the test fails, and the depth's own edge stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import accumulate
from typing import NamedTuple

from defocus_core.depth.matting import radii_by_color
from defocus_core.depth.ramps import HARD_STEP, LEVEL, DistanceScale, slope_of_soft_edges
from defocus_core.tensors.device_plan import pieces, repaired, sent
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import (
    exceeding,
    extreme_around,
    flat_nonzero,
    halfway,
    positions_of,
    range_of,
    squares_around,
)
from defocus_core.tensors.threads import threaded

# Greatest displacement in px; greatest distance in px from the edge at which samples of a surface's
# colours begin, which is also the greatest displacement that a profile proves, and the greatest
# cost; length of the samples in px.
FARTHEST, DEEPEST, SPAN = 8, 6, 5
# Length of a profile to each side of a silhouette, in px: SPAN px beyond the samples test whether
# the surface goes on in their colours.
REACH = DEEPEST + 2 * SPAN + 1
# Half width in px of the square around a pixel in which the normal is found; half of it is the
# standard deviation of the weights there.
NORMAL = 3
# Greatest light: sums of more could be infinite.
_BRIGHTEST = 1e30
# Least standard deviation of the colours of a surface, as a share of their mean; factor by which
# their variance exceeds that of the few samples of one profile.
DEVIATION, WIDER = 0.04, 4.8
# Logarithm of the probability density, in least deviations, of colours that a surface shows beside
# those sampled; how much greater it is on the nearer surface, whose rim may differ from the rest.
OTHER, _RIM = -13.66, 2.5
# Difference of the logarithms of two densities from which on a pixel counts in full.
SURE = 4.0
# Scores of colours on pixels that were not sampled, 1 if all are assigned rightly: the score at
# which colours begin to decide, and that at which they decide fully; for the colours of a picture,
# and for those along a silhouette.
_OF_PICTURE, _OF_SILHOUETTE = (0.5, 0.65), (0.2, 0.5)
# Rounds in which distributions of colours, and costs, are averaged over 5×5 px of a silhouette.
_ROUNDS = 24
# Cost in px above the least at which a displacement has the weight 1 / e: of two that are equally
# likely the mean is taken, so that an edge does not jump from one to the other.
SPREAD = 0.15
# Rounds of averaging that give the displacement expected of a pixel; the cost per px² of a
# difference from it, and the px of difference that cost nothing; and the variance in px² of a
# displacement that is certain.
_LONG, _STIFF, _FREE, _CERTAIN = 60, 1.0, 1.0, 0.5
# Displacements are rounded to 1 / this px.
_GRAINS = 1 << 8
# Weight of the cost of rare displacements; step in px to which it is rounded, so coarse that a few
# pixels more or less change nothing; share of a displacement's votes that counts for each of the
# two displacements a px beside it.
RARITY, COARSE, BESIDE = 1.2, 0.05, 0.25
# Mean size in px of displacements before colours are known; rounds in which votes are counted.
BEFORE, MAXIMIZATIONS = 3.0, 3
# Pixels of silhouettes that are examined for the displacements of the picture; factors of a hash.
_EXAMINED, _FACTORS = 1 << 10, (0x9E3779B97F4A7C1, 0x2545F4914F6CDD1D)
# Hard edges are moved if the median displacement is at least this many px, and at least this share
# of the votes lies within a px of it.
_BIASED, _AGREED = 0.75, 0.6
# A pixel belongs to the nearer surface if its middle lies at most this many px outside the moved
# edge: less than half, for a sharp pixel of both surfaces is conspicuous amid blur; no round
# number, so that averages of whole displacements are no ties.
_REST = 0.2437
# Bytes that a profile takes while it is examined.
_BYTES_EACH = 1 << 13


class ShiftEvidence(NamedTuple):
    """Evidence from colours for the displacement of the depth edge at n silhouette pixels."""

    costs: Tensor  # [n, 2 * FARTHEST + 1] px, of each displacement
    fraction: Tensor  # [n, 1] share of the profiles around that show both surfaces
    # [n, 2] for the pixels beyond the samples: number assigned rightly less wrongly, and number
    told: Tensor
    # [n, K] indices of silhouette pixels within 5×5 px, over which evidence is averaged; n for none
    beside: Tensor


class EdgeShifts(NamedTuple):
    """Statistics of the displacements of a picture's depth edges from those of its colours."""

    step: float  # least step in px of an edge
    median: float  # median displacement in px; positive where depth is too fat, its edges outside
    rarity: tuple[float, ...]  # [2 * FARTHEST + 1] cost of each displacement from -FARTHEST on
    trust: float = 1.0  # weight of the picture's colours, from 0 to 1


def measured_shifts(
    signed_radius: Tensor,  # [H, W] px, without ramps
    pixels: Tensor,  # [C, H, W] linear
    threads: int = 1,
    *,
    soft: float | None = None,
    scale: DistanceScale | None = None,
) -> EdgeShifts | None:
    """The displacements of the edges of a picture; None if edges are not displaced.

    If edges have many pixels, a sample of them is examined. A hash of their surroundings chooses
    it, so that it does not depend on their position in the frame.

    `soft`: least slope in px per px of soft edges, by which an edge must step at least; None if
    edges are hard, which are moved only if most have about the same displacement.
    """
    step, radii, colors = least_step(signed_radius, soft), signed_radius.detach(), pixels.detach()
    edges = _edge_positions(radii, step, scale, threads)
    if not len(edges):
        return None

    def examined(chance: float) -> ShiftEvidence:
        at = edges[_hashes(edges, radii, colors) < chance] if chance < 1 else edges
        # edges that ran within objects were soft; hard ones may only be biased
        rims, silhouette = soft is not None, _silhouette_at(at, radii)
        return edge_evidence(silhouette, radii, colors, threads, along=False, rims=rims)

    evidence = examined(min(_EXAMINED / len(edges), 1.0))
    if 2 * len(evidence.costs) < min(_EXAMINED, len(edges)):  # alike pixels have one hash
        evidence = examined(1.0)
    shifts, agreed = shifts_of(evidence, step)
    is_shifted = soft is not None or (abs(shifts.median) >= _BIASED and agreed >= _AGREED)
    return shifts if is_shifted and bool(evidence.fraction.any()) else None


def least_step(signed_radius: Tensor, soft: float | None) -> float:
    """The least step in px of an edge of radii [H, W] px; `soft` is as for `measured_shifts`."""
    minimum, maximum = range_of(signed_radius.detach()).tolist()
    slope = slope_of_soft_edges(minimum, maximum, signed_radius.shape)
    return max(HARD_STEP * slope, soft or 0.0)


def shifts_of(found: ShiftEvidence, step: float) -> tuple[EdgeShifts, float]:
    """The displacements of a picture, and the share of votes within a px of their median.

    Each silhouette pixel votes for a displacement, one of little evidence as the others do
    (expectation-maximization).

    `step`: least step in px of an edge.
    """
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=found.costs.device)
    votes = before = torch.exp(by.abs().double() / -BEFORE)
    trust = _trust(found.told.sum(0, dtype=torch.float64), _OF_PICTURE)
    weight = found.fraction * _trust(found.told, _OF_SILHOUETTE) * trust
    for _ in range(MAXIMIZATIONS):
        likely = ((found.costs + _rarity(votes)) / -SPREAD).softmax(1)
        votes = before + (likely * weight).sum(0, dtype=torch.float64)
    *each, trusted = torch.cat([votes, trust]).tolist()
    below, half = list(accumulate(each)), sum(each) / 2
    middle = sum(1 for share in below if share < half)
    median = middle - FARTHEST - 0.5 + (half - below[middle] + each[middle]) / each[middle]
    agreed = sum(each[max(middle - 1, 0) : middle + 2]) / (2 * half)
    rarity = _rarity(torch.tensor(each, dtype=torch.float64)).tolist()
    return EdgeShifts(step, median, tuple(rarity), trusted), agreed


def _rarity(votes: Tensor) -> Tensor:
    """The cost in px [2 * FARTHEST + 1] of each displacement, greater the fewer votes it has."""
    fraction = votes / votes.sum()
    limits = torch.cat([fraction[:1], fraction, fraction[-1:]])
    fraction = (1 - 2 * BESIDE) * fraction + BESIDE * (limits[:-2] + limits[2:])
    rarity = -RARITY * (fraction + 0.01).log()
    return ((rarity - rarity.amin()) / COARSE).round() * COARSE


def _hashes(at: Tensor, radii: Tensor, pixels: Tensor) -> Tensor:
    """Pseudo-random numbers [n] in [0, 1) made of the radii and colours around pixels [n, 2]."""
    beside = squares_around(at, (radii.shape[-2], radii.shape[-1])).flatten()
    around = [values.flatten().index_select(0, beside) for values in (radii, *pixels)]
    bits = torch.stack(around).float().view(torch.int32).view(len(around), len(at), 9).long()
    factor = 2 * torch.arange(len(around) * bits.shape[2], device=at.device) + 1
    mixed = (bits * _FACTORS[0] * factor.view(len(around), 1, -1)).sum((0, 2))
    mixed = (mixed ^ (mixed >> 32)) * _FACTORS[1]
    return ((mixed >> 40) & 0xFFFFFF).double() / (1 << 24)


def with_shifted_edges(
    signed_radius: Tensor,
    pixels: Tensor,
    shifts: EdgeShifts,
    scale: DistanceScale | None = None,
    threads: int = 1,
) -> Tensor:
    """Radii [H, W] px with their edges moved to those of the colours [C, H, W]."""
    radii, colors = signed_radius.detach(), pixels.detach()
    silhouette = silhouette_of(radii, shifts.step, scale)
    if silhouette is None:
        return signed_radius
    found = edge_evidence(silhouette, radii, colors, threads)
    shift = likely_shifts(found, shifts)
    trust = _trust(found.told, _OF_SILHOUETTE)[:, 0]
    undecided = torch.zeros_like(radii, dtype=torch.bool)
    undecided[silhouette.at[:, 0], silhouette.at[:, 1]] = trust == 0
    undecided = extreme_around(undecided, NORMAL, torch.maximum)
    return radii_by_color(moved(signed_radius, silhouette, shift), colors, ~undecided)


def silhouette_of(radii: Tensor, step: float, scale: DistanceScale | None) -> Silhouette | None:
    """The silhouette of the edges in radii [H, W] px; None without edges.

    `step`, `scale`: as for `edges_of`.
    """
    at = _edge_positions(radii, step, scale)
    return _silhouette_at(at, radii) if len(at) else None


def moved(signed_radius: Tensor, silhouette: Silhouette, shift: Tensor) -> Tensor:
    """Radii [H, W] px whose edges are moved by `shift` [n] px at the pixels of a silhouette."""
    radii, at = signed_radius.detach(), silhouette.at
    H, W = radii.shape
    if not float(shift.abs().amax()) > _REST:
        return signed_radius
    flat, taken = radii.flatten(), signed_radius.flatten()
    # the median beyond the edge, as a speck may lie right beside it
    along = torch.arange(1.0, 2 * DEEPEST, device=at.device)
    beyond, _ = _profile_pixels(at, silhouette.normal, along, (H, W))
    median = flat[beyond].argsort(dim=1, stable=True)[:, len(along) // 2, None]
    near, far = at[:, 0] * W + at[:, 1], beyond.gather(1, median)[:, 0]
    far = torch.where(flat[far] < flat[silhouette.far], far, silhouette.far)
    order = torch.arange(len(at), device=at.device)
    for key in (flat[far], flat[near], shift, shift.abs()):  # the order decides between ties
        order = order[key[order].argsort(stable=True)]
    at, near, far, shift = at[order], near[order], far[order], shift[order]
    index, owner, distance = _owners(at, shift, (H, W))
    own = flat[index]
    is_near = own < halfway(flat[near][owner], flat[far][owner])
    inwards = torch.where(is_near, distance, -distance)  # px within the nearer surface
    wants_near = inwards > shift[owner] - _REST
    source = torch.where(wants_near, near[owner], far[owner])
    moves = (wants_near != is_near) & (distance <= shift[owner].abs() + 1 + _REST)
    shifted = taken.index_copy(0, index, taken[torch.where(moves, source, index)])
    return shifted.reshape(H, W)


def edge_evidence(
    silhouette: Silhouette,
    radii: Tensor,  # [H, W] px
    pixels: Tensor,  # [C, H, W] linear
    threads: int = 1,
    *,
    along: bool = True,
    rims: bool = True,
) -> ShiftEvidence:
    """Evidence from colours for the displacement of the depth edge at the pixels of a silhouette.

    `along`: whether the evidence is averaged along the silhouette; `rims`: whether the nearer
    surface may have rims of other colours.
    """
    step = pieces(radii.device, _BYTES_EACH)  # profiles to examine at once
    parts = (torch.split(x, step, d) for x, d in zip(silhouette, (0, 0, 1), strict=True))
    every = [Silhouette(*part) for part in zip(*parts, strict=True)]
    profiles = list(threaded(partial(_profiles_of, radii=radii), every, threads))
    moments = torch.cat(list(threaded(partial(_color_moments, pixels=pixels), profiles, threads)))
    beside = _silhouette_neighbours(silhouette.at, radii)[:, : None if along else 0]
    if along:
        moments = _averaged(moments, beside, _ROUNDS)

    def of_piece(piece: tuple[_Profiles, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        return _of_profiles(*piece, pixels, alone=not along, rims=rims)

    each = list(zip(profiles, torch.split(moments, step), strict=True))
    found = threaded(of_piece, each, threads)
    costs, seen, told = map(torch.cat, zip(*found, strict=True))
    if along:
        together = _averaged(torch.cat([seen * costs, seen, told], 1), beside, _ROUNDS)
        weighted, seen, told = together[:, :-3], together[:, -3:-2], together[:, -2:]
        costs = weighted / seen.clamp(min=1e-6) * _trust(told, _OF_SILHOUETTE)
    return ShiftEvidence(costs, seen, told, beside)


def likely_shifts(found: ShiftEvidence, shifts: EdgeShifts) -> Tensor:
    """The displacement [n] in px of the edge at each silhouette pixel, smooth along the edge."""
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=found.costs.device, dtype=torch.float64)
    costs = found.costs * shifts.trust + sent(shifts.rarity, found.costs)
    likely = (costs / -SPREAD).softmax(1)
    mean = (likely * by).sum(1, keepdim=True)
    weight = 1 / ((likely * (by - mean).square()).sum(1, keepdim=True) + _CERTAIN)
    total, weighted = _averaged(torch.cat([weight, weight * mean], 1), found.beside, _LONG).T
    apart = (by - (weighted / total)[:, None]).abs()
    costs = costs + _STIFF * (apart - _FREE).clamp(min=0).square()
    likely = (costs / -SPREAD).softmax(1)
    shift: Tensor = ((likely * by).sum(1) * _GRAINS).round() / _GRAINS
    return shift


def _silhouette_neighbours(at: Tensor, radii: Tensor) -> Tensor:
    """Indices [n, K] in `at` [n, 2] of the silhouette pixels within 5×5 px of each.

    Where a pixel has fewer than K, the rest are n.
    """
    n, (H, W) = len(at), radii.shape
    number = torch.full((H * W,), n, device=at.device)
    number[at[:, 0] * W + at[:, 1]] = torch.arange(n, device=at.device)
    beside = number[squares_around(at, (H, W), 2).flatten(1)].sort(1).values
    return beside[:, : int((beside < n).sum(1).amax()) if n else 0]


def _averaged(values: Tensor, beside: Tensor, rounds: int) -> Tensor:
    """Values [n, K] averaged `rounds` times over neighbouring silhouette pixels.

    `beside`: their indices, from `_silhouette_neighbours`.
    """
    n = len(values)
    values = torch.cat([values, values.new_zeros(1, values.shape[1])]).float()
    beside = torch.cat([beside, beside.new_full((1, beside.shape[1]), n)])
    count = (beside < n).sum(1, keepdim=True).clamp(min=1)
    for _ in range(rounds):
        values = torch.nn.functional.embedding_bag(beside, values, mode="sum") / count
    return values[:n].double()


def _owners(at: Tensor, shift: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """The pixels near a silhouette that shifts may move, each with its closest silhouette pixel.

    Of two equally close silhouette pixels, the first one counts.

    `at`: [n, 2] rows and columns of the silhouette; `shift`: [n] px; `size`: (height, width) of the
    frame. Returns [m] flat indices of pixels, [m] indices in `at`, [m] distances in px.
    """
    n, (H, W), reach = len(at), size, int(shift.abs().amax()) + 2
    offset = torch.arange(-reach, reach + 1, device=at.device)
    away = (offset.square()[:, None] + offset.square()).flatten()
    nobody = n * (int(away.amax()) + 1)
    first = torch.full((H * W,), nobody, device=at.device)
    order, step = torch.arange(n, device=at.device), pieces(at.device, _BYTES_EACH)
    for own, part in zip(torch.split(order, step), torch.split(at, step), strict=True):
        # a pixel outside the frame is clamped to one inside, which another offset finds closer
        around = squares_around(part, size, reach).flatten()
        first.scatter_reduce_(0, around, (away * n + own[:, None]).flatten(), "amin")
    index = flat_nonzero(first < nobody)
    closest = first.index_select(0, index)
    return index, closest % n, closest.div(n, rounding_mode="floor").sqrt()


class Silhouette(NamedTuple):
    """The pixels on the nearer side of depth edges."""

    at: Tensor  # [n, 2] rows and columns
    far: Tensor  # [n] flat index of the farthest of the four pixels beside each
    normal: Tensor  # [2, n] direction (y, x) to the farther surface


def _edge_positions(
    radii: Tensor, step: float, scale: DistanceScale | None, threads: int = 1
) -> Tensor:
    """The rows and columns [n, 2] of the pixels for which `edges_of` radii [H, W] px is True."""
    edges = partial(edges_of, step=step, scale=scale)
    return positions_of(repaired(radii, edges, FARTHEST + 1, threads=threads))


def edges_of(radii: Tensor, step: float, scale: DistanceScale | None) -> Tensor:
    """The pixels [H, W], bool, beside which the radius is greater by more than `step` px.

    If a scale is given, the distance of the surface, converted to px by it, must also be greater by
    more than `step`. Pixels with a much smaller jump than others nearby are left out.
    """
    height = torch.zeros_like(radii)
    for dim in (-2, -1):
        rise = _rise(radii, dim, scale)
        for first, sign in ((0, 1), (1, -1)):
            part = height.narrow(dim, first, rise.shape[dim])
            torch.maximum(part, sign * rise, out=part)
    edges = exceeding(height, step)
    if bool(edges.any()):
        edges &= height > LEVEL * extreme_around(height, FARTHEST, torch.maximum)
    return edges


def _rise(radii: Tensor, dim: int, scale: DistanceScale | None) -> Tensor:
    """The rise in px from each pixel to the next along an axis, of radius or of distance.

    With a scale, it is the smaller of both in size.
    """
    rise = radii.diff(dim=dim)
    if scale is None:
        return rise
    of_distance = scale.distances(radii).diff(dim=dim)
    return torch.where(of_distance.abs() < rise.abs(), of_distance, rise)


def _silhouette_at(at: Tensor, radii: Tensor) -> Silhouette:
    """The silhouette at pixels `at` [n, 2] of radii [H, W] px."""
    size, flat = (radii.shape[-2], radii.shape[-1]), radii.flatten()
    beside = squares_around(at, size).flatten(1)[:, [1, 3, 5, 7]]  # along the axes
    maximum, which = flat[beside].max(1)
    far = beside.gather(1, which[:, None])[:, 0]
    own = flat[at[:, 0] * size[1] + at[:, 1]]
    offset = torch.arange(-NORMAL, NORMAL + 1, device=at.device, dtype=torch.float64)
    y, x = torch.meshgrid(offset, offset, indexing="ij")
    weight = torch.exp((y * y + x * x) / (-2 * (NORMAL / 2) ** 2))
    farther = flat[squares_around(at, size, NORMAL)] > halfway(own, maximum)[:, None, None]
    normal = torch.stack([(farther * (weight * axis)).sum((1, 2)) for axis in (y, x)])
    return Silhouette(at, far, normal / normal.norm(dim=0).clamp(min=1e-6))


def _profile_pixels(
    at: Tensor, normal: Tensor, along: Tensor, size: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Flat indices [n, K] of the pixels across a silhouette, and whether each is in the frame.

    `at`: [n, 2] rows and columns of the silhouette; `normal`: [2, n]; `along`: [K] px from the
    silhouette towards the farther surface; `size`: (height, width) of the frame. A pixel outside
    the frame is replaced by the closest one inside.
    """
    H, W = size
    y, x = (at[:, d, None] + (normal[d, :, None] * along).round().long() for d in (0, 1))
    inside = (y >= 0) & (y <= H - 1) & (x >= 0) & (x <= W - 1)
    return y.clamp(0, H - 1) * W + x.clamp(0, W - 1), inside


class _Profiles(NamedTuple):
    """Lines of pixels across a silhouette, REACH px long to both sides.

    They go from within the nearer surface outwards.
    """

    positions: Tensor  # [n, 2 * REACH + 1] flat indices of pixels
    inwards: Tensor  # [n] number of px of the nearer surface inwards, up to the first gap
    outwards: Tensor  # [n] number of px of the farther surface outwards, up to the first gap

    @property
    def is_seen(self) -> Tensor:
        """[n] bool, whether both surfaces are seen beside the silhouette."""
        return (self.inwards >= 2) & (self.outwards >= 2)

    def depths(self) -> tuple[Tensor, Tensor]:
        """Distances in px from the edge at which samples of colours begin, [n] each.

        First those of the nearer surface, then those of the farther one.
        """
        # a thin surface is sampled from its middle on
        near, far = (
            (count.double() / 2).clamp(max=DEEPEST) for count in (self.inwards, self.outwards)
        )
        return near, far

    def sides(self) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield two masks [n, 2 * REACH + 1] for each surface, the nearer one first.

        They mark the sampled pixels of the surface, and its pixels beyond these.
        """
        for side, depth, count in zip(
            (-1, 1), self.depths(), (self.inwards, self.outwards), strict=True
        ):
            from_edge = side * _profile_offsets(depth)
            deepest = torch.minimum(depth + SPAN, torch.maximum(count - 1.0, depth))[:, None]
            sampled = (from_edge >= depth[:, None] - 0.5) & (from_edge <= deepest + 0.5)
            yield sampled, (from_edge > deepest + 0.5) & (from_edge < count[:, None])


def _profiles_of(silhouette: Silhouette, radii: Tensor) -> _Profiles:
    """The profiles across a silhouette of radii [H, W] px."""
    at, far, normal = silhouette
    size, flat = (radii.shape[-2], radii.shape[-1]), radii.flatten()
    index, inside = _profile_pixels(at, normal, _profile_offsets(at), size)
    is_near = flat[index] < halfway(flat[at[:, 0] * size[1] + at[:, 1]], flat[far])[:, None]
    inwards = (is_near & inside)[:, : REACH + 1].flip(1).long().cumprod(1).sum(1)
    outwards = (~is_near & inside)[:, REACH + 1 :].long().cumprod(1).sum(1)
    return _Profiles(index, inwards, outwards)


def _color_moments(profiles: _Profiles, pixels: Tensor) -> Tensor:
    """Sums [n, 2 * (1 + C + C²)] of 1, colours and their products over the samples of each surface.

    Averaged along a silhouette, these sums give the mean and the covariance of the colours there.
    """
    color, moments = _colors(pixels, profiles.positions), []  # [C, n, 2 * REACH + 1]
    for sampled, _ in profiles.sides():
        samples = color * sampled
        products = torch.einsum("cnt,dnt->ncd", samples, color).flatten(1)
        moments += [sampled.double().sum(1, keepdim=True), samples.sum(2).T, products]
    return torch.cat(moments, 1)


def _trust(told: Tensor, limits: tuple[float, float]) -> Tensor:
    """The weight [..., 1] of colours, 0 to 1, by their score on pixels that were not sampled.

    Similar textures on both sides have no weight, however different two of their samples are.
    `told`: [..., 2], as in `ShiftEvidence`; `limits`: scores of weight 0 and of weight 1.
    """
    least, full = limits
    score = (told[..., :1] + full) / (told[..., 1:] + 1)  # `full` if there are no such pixels
    return ((score - least) / (full - least)).clamp(0, 1)


def _of_profiles(
    profiles: _Profiles, moments: Tensor, pixels: Tensor, *, alone: bool, rims: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """`costs`, `fraction` and `told` of `ShiftEvidence` for each profile, before any averaging.

    `moments`: from `_color_moments`; `alone`: whether these are of single profiles, not averaged
    along the silhouette; `rims`: as for `edge_evidence`.
    """
    nearer = _nearer(profiles, moments, pixels, alone=alone, rims=rims)
    inside, outside = (beyond for _, beyond in profiles.sides())
    right = (nearer * inside - nearer * outside).sum(1)
    told = torch.stack([right, (inside | outside).sum(1)], 1)
    seen = profiles.is_seen.to(told.dtype)[:, None]
    return _displacement_costs(profiles, nearer), seen, told


def _nearer(
    profiles: _Profiles, moments: Tensor, pixels: Tensor, *, alone: bool, rims: bool
) -> Tensor:
    """How surely each pixel of profiles [n, 2 * REACH + 1] shows the nearer surface.

    1 is surely the nearer surface, -1 surely the farther one. Arguments are as for `_of_profiles`;
    `pixels` are [C, H, W] linear.
    """
    color, C = _colors(pixels, profiles.positions), len(pixels)
    sides = torch.split(moments, 1 + C + C * C, 1)
    means = [side[:, 1 : 1 + C] / side[:, :1].clamp(min=1e-9) for side in sides]
    scale = ((means[0] + means[1]) / 2).amax(1).clamp(min=torch.finfo(color.dtype).tiny ** 0.25)
    likely = []
    for side, mean in zip(sides, means, strict=True):
        square = side[:, 1 + C :].view(-1, C, C) / side[:, :1, None].clamp(min=1e-9)
        spread = square - mean[:, :, None] * mean[:, None, :]
        spread = spread * (WIDER if alone else 1.0) / scale.square()[:, None, None]
        spread = spread + DEVIATION**2 * torch.eye(C, dtype=color.dtype, device=color.device)
        root = torch.linalg.cholesky_ex(spread).L
        off = (color.transpose(0, 1) - mean[:, :, None]) / scale[:, None, None]  # [n, C, ...]
        off = torch.linalg.solve_triangular(root, off, upper=False)
        # in least deviations, so that a channel without light changes nothing
        volume = (root.diagonal(dim1=1, dim2=2) / DEVIATION).log().sum(1, keepdim=True)
        likely.append(off.square().sum(1) / -2 - volume)
    near, far = sent([OTHER + rims * _RIM, OTHER], color)
    nearer = torch.logaddexp(likely[0], near) - torch.logaddexp(likely[1], far)
    return (nearer / SURE).nan_to_num().clamp(-1, 1)


def _displacement_costs(profiles: _Profiles, nearer: Tensor) -> Tensor:
    """The cost in px [n, 2 * FARTHEST + 1] of each displacement, 0 for the best one.

    Each pixel that a displacement leaves on the wrong side costs up to 1, the more the likelier its
    colour is on the other side; where the colours of both surfaces are alike, nothing. `nearer`:
    from `_nearer`.
    """
    along, (near_depth, far_depth) = _profile_offsets(nearer), profiles.depths()
    valid = (along >= -near_depth[:, None]) & (along <= far_depth[:, None] + 0.5)
    nearer = nearer * valid
    costs = -nearer.cumsum(1)[:, REACH - FARTHEST : REACH + FARTHEST + 1].flip(1)
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=costs.device)
    possible = (by <= near_depth[:, None]) & (-by <= far_depth[:, None])
    costs = costs - torch.where(possible, costs, torch.inf).amin(1, keepdim=True)
    return torch.where(possible, costs.clamp(max=DEEPEST), float(DEEPEST))


def _profile_offsets(like: Tensor) -> Tensor:
    """The offsets in px [2 * REACH + 1] of a profile's pixels from its silhouette."""
    return torch.arange(-REACH, REACH + 1, device=like.device, dtype=torch.float64)


def _colors(pixels: Tensor, index: Tensor) -> Tensor:
    """Square roots [C, ...] of the linear colours of pixels at flat indices [...], as float64.

    The edges that are found do not depend on the precision of the picture.
    """
    return pixels.flatten(1)[:, index].double().nan_to_num().clamp(0, _BRIGHTEST).sqrt()
