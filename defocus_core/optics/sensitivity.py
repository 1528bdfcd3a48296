"""The sensitivity of a photodiode: its share of the light at each lens point, as a picture.

Kernels that were measured for the left and the right photodiodes say it: at each lens point the
left one gets the share that its kernel is of both. Where neither has light, it is that of the
light around. Measured kernels end softly, amid noise: the border of the lens is where their light
falls to half of its greatest, and faint light has no share.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from defocus_core.optics.pupil_image import PupilImage
from defocus_core.tensors.validation import dense, described

# Shares of the greatest light of a measured kernel: of its noise at most, and of its border.
_FAINT, _BORDER = 0.1, 0.5


class Sensitivity:
    """The share of the light [0, 1] that one of two photodiodes gets, over the lens.

    Two of the same picture are equal.

    Attributes:
        is_left: Whether the photodiode is the left one.
    """

    def __init__(self, share: Tensor, kernel: PupilImage, *, is_left: bool) -> None:
        """Place a picture over the lens.

        Args:
            share: [H, W] in [0, 1], of light that the two get together; all lens points are in it.
            kernel: The picture [H, W] of this light, whose middle and radius are those of the lens.
            is_left: Whether the photodiode is the left one.
        """
        self.is_left = is_left
        self._shares = PupilImage.placed(share, kernel.middle, kernel.radius)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensitivity) and self._shares == other._shares

    def __hash__(self) -> int:
        return hash(self._shares)

    def between(self, x: Tensor, y: Tensor) -> Tensor:
        """The mean share between lens points: [..., m - 1, n - 1]; 0 where there is no area.

        Args:
            x: [..., n], within [-1, 1].
            y: [..., m].
        """
        area = (x.diff()[..., None, :] * y.diff()[..., :, None]).abs()
        share = self._shares.areas(x, y)
        return torch.where(area > 0, share / torch.where(area > 0, area, 1.0), 0.0)


def sensitivities(left: Tensor, right: Tensor) -> tuple[Sensitivity, Sensitivity]:
    """The sensitivities of two photodiodes whose kernels were measured.

    Args:
        left: [H, W], 0 or more: what the left one sees of a point beyond focus.
        right: [H, W], the same of the right one, to the same scale.

    Raises:
        ValueError: If they are no pictures of one size, or no light is in them, or if left does not
            lie to the left.
    """
    for name, kernel in (("left", left), ("right", right)):
        if not (isinstance(kernel, Tensor) and kernel.dim() == 2 and kernel.shape == left.shape):
            problem = f"{name} must be a tensor [H, W] like the other, got {described(kernel)}"
            raise ValueError(f"{problem}; measure both photodiodes of one point")
        dense(name, kernel)
    left, right = (kernel.detach().to("cpu", torch.float64) for kernel in (left, right))
    both = left + right
    PupilImage(both)  # refuses what is no picture
    if not bool((left >= 0).all() and (right >= 0).all()):
        raise ValueError("left and right must be 0 or more, got less; take the black level away")
    column = torch.arange(left.shape[1], dtype=torch.float64)
    first, second = (float(k.sum(0) @ column / k.sum()) if k.any() else 0.0 for k in (left, right))
    if not first < second:
        problem = f"left must lie left of right, got middles at {first:.2f} and {second:.2f} px"
        raise ValueError(f"{problem}; give kernels of a point beyond focus, left first")
    lit = both > _FAINT * both.max()
    left, both = torch.where(lit, left, 0.0), torch.where(lit, both, 0.0)
    side = max(both.shape)
    beyond = (side,) * 4  # the square of lens points is in the picture
    left, both = pad(left, beyond), pad(both, beyond)
    whole = PupilImage(both)
    border = PupilImage(torch.where(both >= _BORDER * both.max(), both, 0.0))
    whole.about(whole.middle, border.reach(whole.middle))
    share = _filled(left, both)
    return (
        Sensitivity(share, whole, is_left=True),
        Sensitivity(1 - share, whole, is_left=False),
    )


def _filled(part: Tensor, whole: Tensor) -> Tensor:
    """The share [H, W] that a part is of the whole; without light that of the light around."""
    share, lit, width = torch.zeros_like(whole), torch.zeros_like(whole, dtype=torch.bool), 1
    while not bool(lit.all()):
        some, every = (
            avg_pool2d(light[None, None], width, 1, width // 2)[0, 0] for light in (part, whole)
        )
        nearer = ~lit & (every > 0)
        share = torch.where(nearer, some / torch.where(nearer, every, 1.0), share)
        lit, width = lit | nearer, 2 * width + 1
    return share.clamp(0, 1)
