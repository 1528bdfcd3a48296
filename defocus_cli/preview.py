"""PNG previews, 8 bit, for looking at: never for measuring."""

from __future__ import annotations

from typing import TYPE_CHECKING

from defocus_cli.encode import display_encoded, write_samples
from defocus_cli.transfer import quantised

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

# sRGB; orange against blue stays apart for all common kinds of colour vision.
NEAR = (0.85, 0.37, 0.01)
IN_FOCUS = (1.0, 1.0, 1.0)
FAR = (0.10, 0.35, 0.70)


def write_preview(path: Path, pixels: NDArray[np.float32]) -> None:
    """Write linear, premultiplied pixels [H, W, C], C = 1…4 as Y, YA, RGB, RGBA, over black.

    Raises:
        InputError: the file cannot be written.
    """
    channels = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}[pixels.shape[2]]
    encoded, _ = display_encoded(pixels, channels, 8, keep_alpha=False)
    write_samples(path, encoded, "png", {})


def write_coc_preview(path: Path, radius: NDArray[np.float32]) -> None:
    """Write signed CoC radii [H, W] in a diverging map: orange near, white in focus, blue far.

    The map is symmetric about 0; full colour is the largest finite |radius|.

    Raises:
        InputError: the file cannot be written.
    """
    write_samples(path, quantised(diverging(radius), 8), "png", {})


def diverging(radius: NDArray[np.float32]) -> NDArray[np.float32]:
    """Colours 0…1 in sRGB, [H, W, 3], of signed radii [H, W]; NaN is black."""
    import numpy as np

    size = np.abs(radius)
    largest = np.max(size, where=np.isfinite(size), initial=0.0) or 1.0
    amount: NDArray[np.float32] = np.minimum(size / np.float32(largest), 1.0)[:, :, None]
    white, near, far = (np.array(c, np.float32) for c in (IN_FOCUS, NEAR, FAR))
    hue: NDArray[np.float32] = np.where((radius < 0)[:, :, None], near, far)
    return white + amount * (hue - white)
