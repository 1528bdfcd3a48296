"""The sensitivity of a photodiode: its share of the light at each lens point, as a picture.

Kernels that were measured for the left and the right photodiodes say it: at each lens point the
left one gets the share that its kernel is of both. Where neither has light, it is that of the
light around. Measured kernels end softly, amid noise: the border of the lens is where their light
falls to half of its greatest, and faint light has no share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.optics.outline import Disc
from defocus_core.optics.pupil_image import PupilImage
from defocus_core.tensors.source import Scalar
from defocus_core.tensors.validation import described

# Shares of the greatest light of a measured kernel: of its noise at most, and of its border.
_FAINT, _BORDER = 0.1, 0.5
# Coarse pixels across a disc whose halves are compared, steps of a scale, and the widest, in radii.
_COARSE, _SCALINGS, _WIDEST = 32, 4, 2.0


class Sensitivity:
    """The share of the light [0, 1] that one of two photodiodes gets, over the lens.

    Two of the same picture are equal; `is_left` says of which of the two it is.
    """

    def __init__(self, fraction: Tensor, kernel: PupilImage, *, is_left: bool) -> None:
        """Place a picture over the lens.

        `fraction`: [H, W] in [0, 1], of light that the two get together; all lens points are in it;
        `kernel`: the picture [H, W] of this light, with the middle and the radius of the lens.
        """
        self.is_left = is_left
        self._fractions = PupilImage.placed(fraction, kernel.middle, kernel.radius)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensitivity) and self._fractions == other._fractions

    def __hash__(self) -> int:
        return hash(self._fractions)

    def between(self, x: Tensor, y: Tensor) -> Tensor:
        """The mean share between lens points x [..., n] and y [..., m]; 0 where nothing is."""
        area = (x.diff()[..., None, :] * y.diff()[..., :, None]).abs()
        fraction = self._fractions.areas(x, y)
        return torch.where(area > 0, fraction / torch.where(area > 0, area, 1.0), 0.0)


class SensitivityField(Sensitivity):
    """Sensitivities of a photodiode over the frame; without a place, it is their mean.

    The frame is divided into rows and columns of equal rectangles, each with its own in its middle.
    Between these places they are mixed, bilinear in the place; beyond the outer ones they stay.
    """

    def __init__(self, positions: Sequence[Sensitivity], grid: tuple[int, int]) -> None:
        """Keep them."""
        self.is_left, self.positions, self.grid = positions[0].is_left, tuple(positions), grid

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SensitivityField):
            return False
        return (self.grid, self.positions) == (other.grid, other.positions)

    def __hash__(self) -> int:
        return hash((self.grid, self.positions))

    def between(self, x: Tensor, y: Tensor) -> Tensor:
        """The mean of theirs."""
        return torch.stack([position.between(x, y) for position in self.positions]).mean(0)

    def view(self, x: Scalar, y: Scalar, frame: tuple[int, int]) -> GridMix:
        """What points of a frame (height, width) see, x and y px from its left upper corner."""
        down, across = (
            _tents(position, length, count)
            for position, length, count in zip((y, x), frame, self.grid, strict=True)
        )
        return GridMix((down[..., :, None] * across[..., None, :]).flatten(-2))

    def mixed(self, weights: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """As `between`, mixed by weights [G] or [v, G] of the places: for v points of the frame."""
        points = weights.reshape(-1, len(self.positions)).to(x.device)
        x, y = (at.expand(len(points), at.shape[-1]) for at in (x, y))
        total = x.new_zeros(len(points), y.shape[-1] - 1, x.shape[-1] - 1)
        for position, weight in zip(self.positions, points.unbind(1), strict=True):
            which = weight.nonzero()[:, 0]
            if len(which):
                seen = position.between(x[which], y[which]) * weight[which, None, None]
                total = total.index_add(0, which, seen)
        return total if weights.dim() > 1 else total[0]


class GridMix(NamedTuple):
    """The mix of the places of a field that points of the frame see."""

    weights: Tensor  # [G] or [n, G] the share of the light of each place

    @property
    def points(self) -> int:
        """The number of points that see it."""
        return math.prod(self.weights.shape[:-1])

    @classmethod
    def joined(cls, mixes: Sequence[GridMix]) -> GridMix:
        """Mixes of one field as one, as so many points see it."""
        return cls(torch.stack([mix.weights for mix in mixes]))

    def of(self, which: Tensor | slice) -> GridMix:
        """The mix as the points of these indices see it."""
        return GridMix(self.weights[which])


def _tents(position: Scalar, length: int, count: int) -> Tensor:
    """Weights [..., count] of the places of a grid along an axis."""
    at = torch.as_tensor(position, dtype=torch.float64) * (count / length) - 0.5
    number = torch.arange(count, dtype=at.dtype, device=at.device)
    return (1 - (at.clamp(0, count - 1)[..., None] - number).abs()).clamp(min=0)


def sensitivities(left: Tensor, right: Tensor) -> tuple[Sensitivity, Sensitivity]:
    """The sensitivities of two photodiodes whose kernels were measured.

    Over the frame each place has a middle of its own, for kernels are seldom measured where the
    pinhole sees the point. The lens has the radius of the narrowest kernel.

    Args:
        left: [H, W], 0 or more: what the left one sees of a point beyond focus; or
            [rows, columns, H, W], over the frame.
        right: The same of the right one, to the same scale.

    Raises:
        ValueError: If they are no pictures of one size, or no light is in them, or if left does not
            lie to the left.
    """
    for name, kernel in (("left", left), ("right", right)):
        alike = isinstance(kernel, Tensor) and kernel.shape == left.shape
        if not (alike and kernel.dim() in (2, 4) and kernel.numel()):
            problem = (
                f"{name} must be a tensor [H, W] or [rows, columns, H, W] like the other, got "
                f"{described(kernel)}"
            )
            raise ValueError(f"{problem}; measure both photodiodes of one point")
    left, right = (kernel.detach().to("cpu", torch.float64) for kernel in (left, right))
    size = left.shape[-2:]
    pairs = zip(left.reshape(-1, *size), right.reshape(-1, *size), strict=True)
    fractions = [_share_of(*pair) for pair in pairs]
    if len(fractions) > 1:
        _scale(fractions)
    first = [Sensitivity(fraction, whole, is_left=True) for fraction, whole, _ in fractions]
    second = [Sensitivity(1 - fraction, whole, is_left=False) for fraction, whole, _ in fractions]
    if left.dim() == 2:
        return first[0], second[0]
    grid = left.shape[0], left.shape[1]
    return SensitivityField(first, grid), SensitivityField(second, grid)


def _scale(fractions: list[tuple[Tensor, PupilImage, float]]) -> None:
    """Scale the pictures of all places, so that halves of a disc are as far apart as kernels are.

    Off the axis blur is wide and soft: a share of such kernels changes too slowly over the lens.
    """
    fraction, narrowest, apart = min(fractions, key=lambda position: position[1].deviation)
    radius, ratio = narrowest.radius, apart / _disc_halves_apart(fraction, narrowest)
    for fraction, whole, apart in fractions:
        whole.about(whole.middle, radius)
        for _ in range(_SCALINGS):
            wider = apart / ratio / _disc_halves_apart(fraction, whole)
            whole.about(whole.middle, min(whole.radius * wider, _WIDEST * radius))


def _disc_halves_apart(fraction: Tensor, whole: PupilImage) -> float:
    """The distance of the centroids of left and right halves of a round lens, in its radii."""
    limits = torch.linspace(-1, 1, _COARSE + 1, dtype=torch.float64)
    light = Disc().areas(limits, limits)
    left = light * Sensitivity(fraction, whole, is_left=True).between(limits, limits)
    return _centroid(light - left) - _centroid(left)


def _centroid(light: Tensor) -> float:
    """The mean place of a picture [H, W] along x, from -1 to 1."""
    at = torch.linspace(-1, 1, 2 * light.shape[1] + 1, dtype=light.dtype)[1::2]
    return float(light.sum(0) @ at / light.sum())


def _share_of(left: Tensor, right: Tensor) -> tuple[Tensor, PupilImage, float]:
    """The share [H, W] of the left of two kernels, their light, and how far centroids are apart."""
    both = left + right
    PupilImage(both)  # refuses what is no picture
    if not bool((left >= 0).all() and (right >= 0).all()):
        raise ValueError("left and right must be 0 or more, got less; take the black level away")
    column = torch.arange(left.shape[1], dtype=torch.float64)
    first, second = (float(k.sum(0) @ column / k.sum()) if k.any() else 0.0 for k in (left, right))
    if not first < second:
        problem = f"left must lie left of right, got middles at {first:.2f} and {second:.2f} px"
        raise ValueError(f"{problem}; give kernels of a point beyond focus, left first")
    bright = both > _FAINT * both.max()
    left, both = torch.where(bright, left, 0.0), torch.where(bright, both, 0.0)
    side = max(both.shape)
    beyond = (side,) * 4  # the square of lens points is in the picture
    left, both = pad(left, beyond), pad(both, beyond)
    whole = PupilImage(both)
    border = PupilImage(torch.where(both >= _BORDER * both.max(), both, 0.0))
    whole.about(whole.middle, border.reach(whole.middle))
    return _fill(left, both), whole, _centroid(both - left) - _centroid(left)


def _fill(part: Tensor, whole: Tensor) -> Tensor:
    """The share [H, W] that a part is of the whole; without light that of the light around."""
    fraction, known, width = torch.zeros_like(whole), torch.zeros_like(whole, dtype=torch.bool), 1
    bright = (whole > 0).to(whole)
    while not bool(known.all()):
        some, every, near = (_boxes(light, width // 2) for light in (part, whole, bright))
        nearer = ~known & (near > 0.5)
        fraction = torch.where(nearer, some / torch.where(nearer, every, 1.0), fraction)
        known, width = known | nearer, 2 * width + 1
    return fraction.clamp(0, 1)


def _boxes(light: Tensor, reach: int) -> Tensor:
    """The sum [H, W] of the square around each pixel, so many px to each side, by running sums."""
    sums = pad(light, (reach + 1, reach, reach + 1, reach)).cumsum(0).cumsum(1)
    rows = sums[2 * reach + 1 :] - sums[: -2 * reach - 1]
    return rows[:, 2 * reach + 1 :] - rows[:, : -2 * reach - 1]
