"""Parts of the pupil: halves, quarters, sixteenths, and the part that a photodiode sees.

Kernels measured for the left and the right photodiodes give their sensitivities: at each lens point
the left kernel divided by the sum of both; where neither has light, the ratio of light around it.
Measured kernels end softly, amid noise: the border of the lens is where their light falls to half
of its maximum, and faint light is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

from defocus_core.optics.outline import Outline, PupilImage
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.validation import Scalar, described

# Cuts between sixteen parts, along both axes, for which the parts of a disc are about equally
# large.
_CUTS = (-1.0, -0.45, 0.0, 0.45, 1.0)
# The least share of the pupil's area that makes a part.
_MIN_PART = 1e-3
# Pixels across the pupil with which the weight of a part of a gaussian pupil is summed.
_WEIGHING_RADIUS = 256.0


@dataclass(frozen=True)
class Part:
    """An axis-parallel part of the pupil in lens coordinates: x0 <= u.x <= x1, y0 <= u.y <= y1.

    Its light is weighted by 1 + lean u.x, or by the sensitivity of a photodiode. In these weights,
    u is a lens point before the pupil is squeezed.
    """

    x0: float = -1.0
    x1: float = 1.0
    y0: float = -1.0
    y1: float = 1.0
    lean: float = 0.0
    sensitivity: Sensitivity | None = None

    @property
    def is_uneven(self) -> bool:
        """Whether the weight varies over the part."""
        return bool(self.lean) or self.sensitivity is not None

    @property
    def is_left(self) -> bool:
        """Whether the part is the left half, lies in it, or is what the left photodiode sees."""
        return self.x1 <= 0 or self.lean < 0 or bool(self.sensitivity and self.sensitivity.is_left)

    def counted(self, u: Tensor, narrowing: tuple[Scalar, Scalar]) -> Tensor:
        """Weights of the light in pixels with corners u [..., n].

        They broadcast to [..., n - 1, n - 1]; `narrowing` is as `Aperture.narrowing`.
        """
        if self.sensitivity is None:
            return 1 + self.lean * narrowing[0] * middles(u)[..., None, :]
        x, y = ((u * times).clamp(-1, 1) for times in narrowing)
        return 2 * self.sensitivity.mean_share(x, y)

    def clamp(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Lens coordinates clamped to the part."""
        return x.clamp(self.x0, self.x1), y.clamp(self.y0, self.y1)


FULL = Part()
LEFT = Part(x1=0.0)
RIGHT = Part(x0=0.0)


@lru_cache(maxsize=256)
def parts_of(outline: Outline, count: int) -> tuple[Part, ...]:
    """The 1, 2, 4 or 16 parts of a pupil, first those of the LEFT half; see `Aperture.parts`."""
    if count == 1:
        return (FULL,)
    if count == 2:
        return LEFT, RIGHT
    minimum = _MIN_PART * area_of(outline, FULL)
    if count == 4:
        cuts = [(half, _bisecting_height(outline, half)) for half in (LEFT, RIGHT)]
        return tuple(p for half, y in cuts for p in (replace(half, y1=y), replace(half, y0=y)))
    sides = list(pairwise(_CUTS))
    parts = (Part(x0, x1, y0, y1) for x0, x1 in sides for y0, y1 in sides)
    return tuple(part for part in parts if area_of(outline, part) > minimum)


def _bisecting_height(outline: Outline, part: Part) -> float:
    """The y of the horizontal cut that halves a part's area, by bisection."""
    low, high, half = part.y0, part.y1, area_of(outline, part) / 2
    for _ in range(50):
        middle = (low + high) / 2
        if abs(excess := area_of(outline, replace(part, y1=middle)) - half) < 1e-14:
            return middle
        low, high = (middle, high) if excess < 0 else (low, middle)
    return (low + high) / 2


@lru_cache(maxsize=4096)
def area_of(outline: Outline, part: Part) -> Any:
    """Area of the part in lens radii squared: a number, or a tensor if gradients flow to it."""
    x = torch.tensor([part.x0, part.x1], dtype=torch.float64, device="cpu")
    y = torch.tensor([part.y0, part.y1], dtype=torch.float64, device="cpu")
    area = outline.areas(x, y)
    return area[0, 0] if area.requires_grad else float(area)


@lru_cache(maxsize=256)
def weight_of(outline: Outline, part: Part) -> Any:
    """The integral of the gaussian profile over the part; unit and type are those of `area_of`."""
    u = torch.arange(-_WEIGHING_RADIUS, _WEIGHING_RADIUS + 1, dtype=torch.float64, device="cpu")
    u = u / _WEIGHING_RADIUS
    weight = (outline.areas(*part.clamp(u, u)) * gaussian(u)).sum()
    return weight if weight.requires_grad else float(weight)


def gaussian(u: Tensor) -> Tensor:
    """exp(-|u|² / 2) at the middle of pixels, [..., n - 1, n - 1], whose corners are u [..., n].

    Corners are clamped to [-1, 1], which keeps the result positive for any radius.
    """
    middle = middles(u)
    fall = torch.exp(-(middle**2) / 2)
    return fall[..., :, None] * fall[..., None, :]


def middles(u: Tensor) -> Tensor:
    """The middles [..., n - 1] of pixels with corners u [..., n], first clamped to [-1, 1]."""
    inside = u.clamp(-1, 1)
    return (inside[..., 1:] + inside[..., :-1]) / 2


# Shares of the maximum of a measured kernel: light below the first is noise, and light falls to the
# second at the border of the lens.
_FAINT, _BORDER = 0.1, 0.5


class Sensitivity:
    """The share of the light, 0 to 1, that one of two photodiodes gets at each lens point.

    Instances with equal pictures are equal. `is_left` is True for the left photodiode.
    """

    def __init__(self, fraction: Tensor, kernel: PupilImage, *, is_left: bool) -> None:
        """Set the sensitivity over the lens.

        Args:
            fraction: The share of this photodiode in the light of both, [H, W] in [0, 1]; it covers
                all lens points.
            kernel: The light of both photodiodes [H, W], with the middle and the radius of the
                lens.
            is_left: Whether this is the left photodiode.
        """
        self.is_left = is_left
        self._fractions = PupilImage.placed(fraction, kernel.middle, kernel.radius)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensitivity) and self._fractions == other._fractions

    def __hash__(self) -> int:
        return hash(self._fractions)

    def mean_share(self, x: Tensor, y: Tensor) -> Tensor:
        """The mean share between consecutive lens points x [..., n] and y [..., m].

        It is [..., m - 1, n - 1], 0 in rectangles without area.
        """
        area = (x.diff()[..., None, :] * y.diff()[..., :, None]).abs()
        fraction = self._fractions.areas(x, y)
        return torch.where(area > 0, fraction / torch.where(area > 0, area, 1.0), 0.0)


def sensitivities(left: Tensor, right: Tensor) -> tuple[Sensitivity, Sensitivity]:
    """The sensitivities of the left and the right photodiode, from their measured kernels.

    Args:
        left: [H, W], 0 or more: the image of a point beyond focus in the left photodiode.
        right: The same in the right photodiode, to the same scale.

    Returns:
        (left, right).

    Raises:
        ValueError: If they are not pictures of one size, are negative or black, or the left image
            does not lie to the left.
    """
    for name, kernel in (("left", left), ("right", right)):
        alike = isinstance(kernel, Tensor) and kernel.shape == left.shape
        if not (alike and kernel.dim() == 2 and kernel.numel()):
            problem = f"{name} must be a tensor [H, W] like the other, got {described(kernel)}"
            raise ValueError(f"{problem}; measure both photodiodes of one point")
    left, right = (kernel.detach().to("cpu", torch.float64) for kernel in (left, right))
    fraction, whole = _share_of(left, right)
    return (
        Sensitivity(fraction, whole, is_left=True),
        Sensitivity(1 - fraction, whole, is_left=False),
    )


def _share_of(left: Tensor, right: Tensor) -> tuple[Tensor, PupilImage]:
    """The share [H, W] of the left kernel in the sum of both, and this sum."""
    both = left + right
    PupilImage(both)  # raises if one is not a picture
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
    beyond = (side,) * 4  # so that the picture holds the square of lens points
    left, both = torch.nn.functional.pad(left, beyond), torch.nn.functional.pad(both, beyond)
    whole = PupilImage(both)
    border = PupilImage(torch.where(both >= _BORDER * both.max(), both, 0.0))
    whole.set_circle(whole.middle, border.reach(whole.middle))
    return _fill(left, both), whole


def _fill(part: Tensor, whole: Tensor) -> Tensor:
    """The ratio part / whole [H, W]; where the whole is dark, that of sums around the pixel."""
    fraction, known, width = torch.zeros_like(whole), torch.zeros_like(whole, dtype=torch.bool), 1
    bright = (whole > 0).to(whole)
    while not bool(known.all()):
        some, every, near = (_boxes(light, width // 2) for light in (part, whole, bright))
        nearer = ~known & (near > 0.5)
        fraction = torch.where(nearer, some / torch.where(nearer, every, 1.0), fraction)
        known, width = known | nearer, 2 * width + 1
    return fraction.clamp(0, 1)


def _boxes(light: Tensor, reach: int) -> Tensor:
    """The sums [H, W] over squares that reach `reach` px to each side of a pixel."""
    sums = torch.nn.functional.pad(light, (reach + 1, reach, reach + 1, reach)).cumsum(0).cumsum(1)
    rows = sums[2 * reach + 1 :] - sums[: -2 * reach - 1]
    return rows[:, 2 * reach + 1 :] - rows[:, : -2 * reach - 1]
