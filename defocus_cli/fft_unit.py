"""How long work takes, and the unit: one transform there and back of a frame, RGBA float32.

Of one thread, however many render: two that share it take from half as long to longer, as their
memory is at hand or not. And of memory that the system hands out anew each time, as in a new
process: what happens to be at hand halves the time of a transform, and would decide about the unit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING

from defocus_cli import memory

if TYPE_CHECKING:
    from torch import Tensor

# It is measured so often, or until so many seconds are spent on it.
_MOST, _ENOUGH = 7, 0.1


def timed(work: Callable[[], Tensor], repeat: int) -> tuple[Tensor, float]:
    """What some work gives, and the median of the seconds it takes."""
    import torch

    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        result = work()
        if result.is_cuda:
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return result, median(seconds)


class FftUnit:
    """The unit for an image."""

    def __init__(self, image: Tensor) -> None:
        """Nothing is measured yet.

        Args:
            image: [..., H, W], of its size, where it is.
        """
        import torch

        height, width = image.shape[-2:]
        frame = torch.rand((4, height, width), generator=torch.Generator().manual_seed(0))
        self._frame = frame.to(image.device)
        self.seconds()  # plans are made once

    def seconds(self) -> float:
        """The median of several, of fewer where it is long."""
        found = [self._once()]
        while len(found) < _MOST and sum(found) < _ENOUGH:
            found.append(self._once())
        return median(found)

    def _once(self) -> float:
        memory.trim()
        return timed(self._round_trip, 1)[1]

    def _round_trip(self) -> Tensor:
        import torch

        back: Tensor = torch.fft.irfft2(torch.fft.rfft2(self._frame), s=self._frame.shape[-2:])
        return back
