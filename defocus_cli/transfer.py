"""The sRGB transfer curve, exact (IEC 61966-2-1), between file integers and linear light."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def srgb_to_linear(encoded: NDArray[Any]) -> NDArray[np.float64]:
    """Linear light of sRGB values, both 0…1."""
    import numpy as np

    value = np.asarray(encoded, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Encoded sRGB values of linear light, both 0…1; negative light is taken as 0."""
    import numpy as np

    value = np.maximum(linear, np.float32(0.0))
    toe = np.minimum(value, np.float32(1.0)) * np.float32(12.92)  # what is near the largest float
    curve = np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(value <= np.float32(0.0031308), toe, curve)


@cache
def decoding_table(bits: int, gamma: float | None = None) -> NDArray[np.float32]:
    """Linear light of every integer of a file with 8 or 16 bits, [2^bits].

    Args:
        bits: 8 or 16.
        gamma: exponent of a file that declares a power law (1 = linear); None for sRGB.
    """
    import numpy as np

    encoded = np.arange(2**bits) / (2**bits - 1)
    linear = srgb_to_linear(encoded) if gamma is None else encoded**gamma
    return linear.astype(np.float32)


def quantised(values: NDArray[np.float32], bits: int) -> NDArray[Any]:
    """Values 0…1 as the nearest integers of 8 or 16 bits; what lies outside is clipped."""
    import numpy as np

    clipped = np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)
    levels: NDArray[np.float32] = np.rint(clipped * np.float32(2**bits - 1))
    return levels.astype(np.uint8 if bits == 8 else np.uint16)
