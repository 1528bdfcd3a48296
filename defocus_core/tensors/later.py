"""torch, imported at its first use: the import takes a second, and compiled loops need no torch.

Modules that are also imported for rendering by compiled loops import `torch` and `Tensor` from
here.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch as torch
    from torch import Tensor as Tensor
else:

    class _Torch:
        """The module torch, imported when one of its names is first used."""

        def __getattr__(self, name: str) -> Any:
            import torch

            self.__dict__ = vars(torch)
            return getattr(torch, name)

    class _OfTensors(type):
        def __instancecheck__(cls, value: object) -> bool:
            """Whether a value is a tensor; False before torch is imported."""
            return "torch" in sys.modules and isinstance(value, torch.Tensor)

    class Tensor(metaclass=_OfTensors):
        """`torch.Tensor`, for `isinstance` and annotations."""

    torch = _Torch()
