"""The search for the point that explains a pair: a grid, then Gauss-Newton steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from defocus_core.fitting.pictures import Scale, offset_of
from defocus_core.fitting.residual import Residual, error_of, robust_of
from defocus_core.fitting.unknowns import MOST_SHIFT, Candidate, Unknown, moved, rotation_of
from defocus_core.optics.aperture import Aperture

MIDDLE = 480  # px, width of pictures of middle size
_COARSE = 200  # px, width of small pictures
_RADII = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)  # px, largest blur of the coarse search
_PLACES = (0.02, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 0.98)  # quantiles of disparity in focus
_STEPS = {_COARSE: 4, MIDDLE: 4, None: 3}  # most Gauss-Newton steps at a width
_STARTS = 3  # of the best of the coarse search
_TURNS = 4  # rotations tried between a blade and the next
_BLOCKS = 6  # along each side, for the uncertainty
_AROUND = ((0.1, 0.04), (0.05, 0.015))  # steps in strength and focus from a point to others
_ROUNDS = 4  # most steps of each size
_ENOUGH = 2e-4  # a smaller step is none
_SHORTER = (1.0, 0.35, 0.1)  # shares of a step that are tried
_DAMPING = 1e-4
_ASIDE = (-1.5, -0.75, 0.0, 0.75, 1.5)  # px of radius that the focus is tried aside
_AS_GOOD = 1.002  # an error as small, by the rounding of the renderer


@dataclass(frozen=True)
class Found:
    """A point, its pupil and its error."""

    error: float
    point: Candidate
    aperture: Aperture


class Search:
    """The search for the point between two pictures."""

    def __init__(self, residual: Residual, free: Sequence[Unknown], *, rotation: bool) -> None:
        """Keep what is to be found.

        Args:
            residual: The differences that are to be small.
            free: The unknowns.
            rotation: Whether pupils with blades are turned.
        """
        self.residual = residual
        self._free, self._rotation = list(free), rotation

    def free(self, aperture: Aperture) -> list[Unknown]:
        """The unknowns beside a pupil."""
        turns = self._rotation and aperture.blades
        return [*self._free, rotation_of(aperture)] if turns else self._free

    def best(self, apertures: Sequence[Aperture]) -> Found:
        """The point of least error, and the pupil that makes it."""
        first, small = apertures[0], self.residual.scale(_COARSE)
        starts = sorted(self._coarse(first, small), key=lambda found: found.error)[:_STARTS]
        found = min(
            (self._descended(start, small, _COARSE, self._free) for start in starts),
            key=lambda found: found.error,
        )
        found = self._best_around(found, small)
        if self.residual.width > MIDDLE:
            found = self._descended(found, self.residual.scale(MIDDLE), MIDDLE, self._free)
        found = self._with_pupil(found, apertures)
        found = self._descended(found, self.residual.scale(None), None, self.free(found.aperture))
        return self._centred(found)

    def _coarse(self, aperture: Aperture, scale: Scale) -> list[Found]:
        """The error of each point of a grid."""
        values, shift = scale.disparity.flatten().double(), self._shift()
        places = torch.quantile(values, torch.tensor(_PLACES, dtype=torch.float64)).tolist()
        found = []
        for radius, focus in product(_RADII, dict.fromkeys(places)):
            point = Candidate(radius / float((focus - values).abs().max()), focus, **shift)
            error = error_of(*self.residual.of(point, aperture, scale, "draft"))
            found.append(Found(error, point, aperture))
        return found

    def _best_around(self, found: Found, scale: Scale) -> Found:
        """The best of points around a point, from which steps descend again.

        Discs of lights have edges, between which the error has valleys of its own.
        """
        ways = [way for way in product((-1, 0, 1), repeat=2) if any(way)]
        for sizes in _AROUND:
            for _ in range(_ROUNDS):
                steps = ([way[0] * sizes[0], way[1] * sizes[1]] for way in ways)
                points = (moved(found.point, self._free[:2], step) for step in steps)
                tried = (self._at(point, found.aperture, scale) for point in points)
                there = min(tried, key=lambda each: each.error)
                if there.error >= found.error:
                    break
                found = self._descended(there, scale, _COARSE, self._free)
        return found

    def _shift(self) -> dict[str, float]:
        """The shift in whole px, if it is free."""
        names = ("across", "down")
        if not any(unknown.name in names for unknown in self._free):
            return {}
        scale = self.residual.scale(None)
        seen = torch.stack(scale.seen).mean(0)
        return dict(zip(names, offset_of(scale.sharp, seen, int(MOST_SHIFT)), strict=True))

    def _with_pupil(self, found: Found, apertures: Sequence[Aperture]) -> Found:
        """The pupil that explains the pictures best, near a point."""
        turned = any(self._rotation and each.blades for each in apertures)
        if len(apertures) == 1 and not turned:
            return found
        scale = self.residual.scale(MIDDLE)
        candidates = []
        for aperture in apertures:
            turns = _TURNS if self._rotation and aperture.blades else 1
            angles = [360 * turn / (turns * max(aperture.blades, 1)) for turn in range(turns)]
            tried = (self._at(replace(found.point, rotation=a), aperture, scale) for a in angles)
            start = min(tried, key=lambda each: each.error)
            candidates.append(self._descended(start, scale, MIDDLE, self.free(aperture)))
        return min(candidates, key=lambda each: each.error)

    def _at(self, point: Candidate, aperture: Aperture, scale: Scale) -> Found:
        return Found(error_of(*self.residual.of(point, aperture, scale)), point, aperture)

    def _descended(
        self, start: Found, scale: Scale, width: int | None, free: list[Unknown]
    ) -> Found:
        """A point after Gauss-Newton steps."""
        found = self._at(start.point, start.aperture, scale)
        for _ in range(_STEPS[width]):
            hessian, gradient = self.normal(found, scale, free)
            whole = hessian.sum(0)
            damped = whole + _DAMPING * torch.diag(whole.diagonal())
            step = -torch.linalg.solve(damped + 1e-12 * torch.eye(len(free)), gradient.sum(0))
            most = torch.tensor([unknown.most for unknown in free], dtype=torch.float64)
            step = step.clamp(-most, most)
            for share in _SHORTER:
                point = moved(found.point, free, (share * step).tolist())
                there = self._at(point, found.aperture, scale)
                if there.error < found.error:
                    break
            else:
                return found
            found = there
            if float(step.abs().max()) * share < _ENOUGH:
                break
        return found

    def normal(self, found: Found, scale: Scale, free: list[Unknown]) -> tuple[Tensor, Tensor]:
        """Of each block of the picture the matrix [B, P, P] and the gradient [B, P] of a step."""
        residual, weight = self.residual.of(found.point, found.aperture, scale)
        robust = robust_of(residual, weight)
        slopes = []
        for index, unknown in enumerate(free):
            steps = [0.0] * len(free)
            steps[index] = unknown.probe
            there, _ = self.residual.of(moved(found.point, free, steps), found.aperture, scale)
            slopes.append((there - residual) / unknown.probe)
        jacobian = torch.stack(slopes)  # [P, V, C, H, W]
        pieces_h, pieces_g = [], []
        height, width = residual.shape[2:]
        for row, column in product(range(_BLOCKS), range(_BLOCKS)):
            cut = (
                ...,
                slice(row * height // _BLOCKS, (row + 1) * height // _BLOCKS),
                slice(column * width // _BLOCKS, (column + 1) * width // _BLOCKS),
            )
            slope = jacobian[cut].flatten(1).double()
            weighed = slope * robust[cut].flatten().double()
            pieces_h.append(weighed @ slope.T)
            pieces_g.append(weighed @ residual[cut].flatten().double())
        return torch.stack(pieces_h), torch.stack(pieces_g)

    def _centred(self, found: Found) -> Found:
        """The focus in the middle of those that are as good: within half a px all is sharp."""
        scale, strength = self.residual.scale(None), found.point.strength
        px = torch.tensor(_ASIDE, dtype=torch.float64)

        def aside(by: float) -> Found:
            point = replace(found.point, focus=found.point.focus + by / strength)
            return self._at(point, found.aperture, scale)

        errors = [aside(by).error for by in _ASIDE]
        if not all(map(math.isfinite, errors)):
            return found
        powers = torch.stack([px**0, px, px**2], 1)
        _, slope, bend = torch.linalg.lstsq(powers, torch.tensor(errors).double()).solution.tolist()
        if bend <= 0:
            return found
        there = aside(min(max(-slope / (2 * bend), -1.0), 1.0))
        return there if there.error <= found.error * _AS_GOOD else found
