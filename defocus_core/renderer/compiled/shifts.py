"""A quick test whether edges of depth could be displaced from edges of colour.

Compiled loops examine some profiles across silhouettes, as `depth/displacement.py` does, with the
same constants. If their median displacement is about 0, no edge counts as displaced.
"""

from __future__ import annotations

import math

import numpy as np

from defocus_core.depth import displacement
from defocus_core.depth.displacement import DEEPEST, FARTHEST, NORMAL, REACH
from defocus_core.depth.ramps import LEVEL
from defocus_core.renderer.compiled.jit import compiled, entry
from defocus_core.tensors.neighbourhoods import HALFWAY

F32 = np.float32
_PROFILES, _VOTES = 512, 20
# Median displacement in px that is none for certain: more is measured with care.
_CENTRED = 0.5
_ALONG, _SHIFTS, _TINY = 2 * REACH + 1, 2 * FARTHEST + 1, float(np.finfo(np.float64).tiny) ** 0.25


@entry
def may_be_shifted(image, radius, step):
    """Whether most depth edges may be displaced from edges of colour, by the same distance.

    image: [3, H, W]; radius: [H, W] px; step: least difference of radii at an edge, in px.
    """
    height, width = radius.shape
    rise = np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            for v, u in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                if 0 <= v < height and 0 <= u < width:
                    rise[y, x] = max(rise[y, x], radius[v, u] - radius[y, x])
    edges = 0
    for y in range(height):
        for x in range(width):
            edges += rise[y, x] > step
    every = 1 + edges // _PROFILES
    costs, told, seen = np.empty((_PROFILES, _SHIFTS)), np.zeros((_PROFILES, 2)), 0
    positions, colors = np.empty((_ALONG, 2), np.int64), np.empty((_ALONG, 3))
    likely = np.empty((2, _ALONG))
    count = edges = 0
    for y in range(height):
        for x in range(width):
            edges += rise[y, x] > step
            if rise[y, x] <= step or edges % every or not _is_highest(rise, y, x):
                continue
            depths = _find_profile(radius, y, x, rise[y, x], positions)
            for k in range(_ALONG):
                for c in range(3):
                    light = max(image[c, positions[k, 0], positions[k, 1]], F32(0))
                    colors[k, c] = math.sqrt(light)
            _compare(colors, depths, likely, costs[count], told[count])
            if min(depths[0], depths[1]) >= 2:
                seen += 1
            else:
                costs[count, 0] = np.inf  # it has no vote
            count += 1
    return seen > _VOTES and abs(_median(costs[:count], told[:count])) >= _CENTRED


@compiled
def _is_highest(rise, y, x):
    """Whether the rise at pixel (y, x) is about as high as the highest rise near it."""
    highest = F32(0)
    for v in range(max(y - FARTHEST, 0), min(y + FARTHEST + 1, rise.shape[0])):
        for u in range(max(x - FARTHEST, 0), min(x + FARTHEST + 1, rise.shape[1])):
            highest = max(highest, rise[v, u])
    return rise[y, x] > F32(LEVEL) * highest


@compiled
def _find_profile(radius, y, x, rise, positions):
    """Write the pixels of a profile across an edge, nearer surface first, to `positions`.

    positions: [2 REACH + 1, 2]. Returns the numbers of successive pixels from the edge that lie on
    the nearer and on the farther surface.
    """
    height, width = radius.shape
    border, ny, nx = radius[y, x] + rise * F32(HALFWAY), 0.0, 0.0
    for a in range(-NORMAL, NORMAL + 1):
        for b in range(-NORMAL, NORMAL + 1):
            v, u = min(max(y + a, 0), height - 1), min(max(x + b, 0), width - 1)
            if radius[v, u] > border:
                weight = math.exp((a * a + b * b) / (-2 * (NORMAL / 2) ** 2))
                ny, nx = ny + weight * a, nx + weight * b
    norm = max(math.sqrt(ny * ny + nx * nx), 1e-6)
    inwards = outwards = 0
    for k in range(-REACH, REACH + 1):
        v, u = y + np.int64(np.rint(ny / norm * k)), x + np.int64(np.rint(nx / norm * k))
        inside = 0 <= v < height and 0 <= u < width
        v, u = min(max(v, 0), height - 1), min(max(u, 0), width - 1)
        positions[k + REACH, 0], positions[k + REACH, 1] = v, u
        is_near = radius[v, u] < border
        if k <= 0:
            inwards = inwards + 1 if inside and is_near else 0
        elif outwards == k - 1 and inside and not is_near:
            outwards = k
    return inwards, outwards


@compiled
def _compare(colors, counts, likely, costs, told):
    """Write the cost of each displacement of an edge, judged by the colours along its profile.

    counts: pixels of the profile on both surfaces; likely: [2, 2 REACH + 1] scratch; costs: [17];
    told: [2], increased by the sum and the number of votes: pixels far from the edge vote on
    whether their colours agree with the depth.
    """
    near, far = min(counts[0] / 2, DEEPEST), min(counts[1] / 2, DEEPEST)
    means, moments, deepest = np.zeros((2, 3)), np.zeros((2, 3, 3)), np.empty(2)
    scale = _TINY
    for side in range(2):
        depth, total = far if side else near, 0
        deepest[side] = min(depth + displacement.SPAN, max(counts[side] - 1.0, depth))
        for k in range(_ALONG):
            away = k - REACH if side else REACH - k
            if depth - 0.5 <= away <= deepest[side] + 0.5:
                total += 1
                for i in range(3):
                    means[side, i] += colors[k, i]
                    for j in range(3):
                        moments[side, i, j] += colors[k, i] * colors[k, j]
        for i in range(3):
            means[side, i] /= max(total, 1e-9)
            for j in range(3):
                moments[side, i, j] /= max(total, 1e-9)
    for i in range(3):
        scale = max(scale, (means[0, i] + means[1, i]) / 2)
    for side in range(2):
        _find_likelihood(colors, means[side], moments[side], scale, likely[side])
    total, least = 0.0, np.inf
    for k in range(_ALONG):
        along, nearer = k - REACH, likely[0, k] - likely[1, k]
        nearer = min(max(nearer / displacement.SURE, -1.0), 1.0)
        for side in range(2):
            away = along if side else -along
            if deepest[side] + 0.5 < away < counts[side]:
                told[0] += -nearer if side else nearer
                told[1] += 1
        total += nearer if -near <= along <= far + 0.5 else 0.0
        if abs(along) <= FARTHEST:
            possible = -along <= near and along <= far
            costs[FARTHEST - along] = -total if possible else np.inf
            least = min(least, costs[FARTHEST - along])
    for s in range(_SHIFTS):
        costs[s] = min(costs[s] - least, DEEPEST)


@compiled
def _find_likelihood(colors, mean, moments, scale, likely):
    """Write the log-likelihood of colours [n, 3] on a surface with a mean and moments of colour.

    mean: [3]; moments: [3, 3] means of products; scale: by which colours are divided; likely: [n].
    """
    root, z = np.zeros((3, 3)), np.empty(3)
    volume = 0.0
    for i in range(3):
        for j in range(i + 1):
            spread = (moments[i, j] - mean[i] * mean[j]) * displacement.WIDER / (scale * scale)
            spread += displacement.DEVIATION**2 if i == j else 0.0
            for k in range(j):
                spread -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(max(spread, 1e-12)) if i == j else spread / root[j, j]
        volume += math.log(root[i, i] / displacement.DEVIATION)
    for n in range(len(likely)):
        square = 0.0
        for i in range(3):
            z[i] = (colors[n, i] - mean[i]) / scale
            for j in range(i):
                z[i] -= root[i, j] * z[j]
            z[i] /= root[i, i]
            square += z[i] * z[i]
        likely[n] = math.log(math.exp(square / -2 - volume) + math.exp(displacement.OTHER))


@compiled
def _trust(told, total, least, full):
    return min(max(((told + full) / (total + 1) - least) / (full - least), 0.0), 1.0)


@compiled
def _median(costs, told):
    """The median displacement in px of profiles, from costs [n, 17] and votes `told` [n, 2]."""
    right = every = 0.0
    for n in range(len(told)):
        right, every = right + told[n, 0], every + told[n, 1]
    of_picture = _trust(right, every, 0.5, 0.65)
    votes, rarity, share = np.zeros(_SHIFTS), np.empty(_SHIFTS), np.empty(_SHIFTS)
    for times in range(displacement.MAXIMIZATIONS + 1):
        total, least = 0.0, np.inf
        for s in range(_SHIFTS):
            total += votes[s]
        for s in range(_SHIFTS):
            beside = displacement.BESIDE * (votes[max(s - 1, 0)] + votes[min(s + 1, _SHIFTS - 1)])
            share[s] = ((1 - 2 * displacement.BESIDE) * votes[s] + beside) / max(total, 1e-9)
            rarity[s] = -displacement.RARITY * math.log(share[s] + 0.01)
            least = min(least, rarity[s])
        for s in range(_SHIFTS):
            rarity[s] = np.rint((rarity[s] - least) / displacement.COARSE) * displacement.COARSE
            votes[s] = math.exp(abs(s - FARTHEST) / -displacement.BEFORE)
        for n in range(len(costs) if times else 0):
            if costs[n, 0] == np.inf:
                continue
            total, weight = 0.0, of_picture * _trust(told[n, 0], told[n, 1], 0.2, 0.5)
            for s in range(_SHIFTS):
                share[s] = math.exp((costs[n, s] + rarity[s]) / -displacement.SPREAD)
                total += share[s]
            for s in range(_SHIFTS):
                votes[s] += share[s] / total * weight
    half, below, s = 0.0, 0.0, 0
    for k in range(_SHIFTS):
        half += votes[k] / 2
    while below + votes[s] < half:
        below += votes[s]
        s += 1
    return s - FARTHEST - 0.5 + (half - below) / votes[s]
