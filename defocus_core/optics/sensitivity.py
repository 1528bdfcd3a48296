"""The sensitivity of a photodiode: its share of the light at each lens point, as a picture.

Kernels that were measured for the left and the right photodiodes say it: at each lens point the
left one gets the share that its kernel is of both. Where neither has light, it is that of the
light around. Measured kernels end softly, amid noise: the border of the lens is where their light
falls to half of its greatest, and faint light has no share.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.optics.pupil_image import PupilImage
from defocus_core.tensors.validation import described

# Shares of the greatest light of a measured kernel: of its noise at most, and of its border.
_FAINT, _BORDER = 0.1, 0.5


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


def sensitivities(left: Tensor, right: Tensor) -> tuple[Sensitivity, Sensitivity]:
    """The sensitivities of two photodiodes whose kernels were measured.

    Args:
        left: [H, W], 0 or more: what the left one sees of a point beyond focus.
        right: The same of the right one, to the same scale.

    Raises:
        ValueError: If they are no pictures of one size, or no light is in them, or if left does not
            lie to the left.
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
    """The share [H, W] of the left of two kernels, and their light."""
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
    return _fill(left, both), whole


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
