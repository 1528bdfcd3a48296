"""A picture of a map of point spread functions, drawn with matplotlib."""

from __future__ import annotations

from typing import Any

from torch import Tensor

# Added to a kernel before its logarithm is taken: the darkest value shown.
_DARKEST = 1e-4
# Length of the scale bar in mm, and its distance from the corner in px.
_BAR, _MARGIN = 0.1, 20


def drawn(
    psf_map: Tensor, pixel_size: float, log_scale: bool, save_name: str | None
) -> tuple[Any, Any] | None:
    """Draw kernels side by side over a scale bar of 100 µm.

    `psf_map`: [rows, columns, 3, ks, ks]; `pixel_size`: mm; `save_name`: the picture file to write;
    None to return (figure, axes).
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        problem = "drawing needs matplotlib, which is not installed"
        raise ImportError(f"{problem}; run: pip install 'defocus[plot]'") from error

    rows, columns, _, ks, _ = psf_map.shape
    bright = (psf_map + _DARKEST).log() if log_scale else psf_map
    low = bright.amin((2, 3, 4), keepdim=True) if log_scale else 0.0
    high = bright.amax((2, 3, 4), keepdim=True)
    # a map of level kernels is white
    shown = ((bright - low) / (high - low)).nan_to_num(1.0)
    mosaic = shown.permute(0, 3, 1, 4, 2).reshape(rows * ks, columns * ks, 3)
    figure, axes = pyplot.subplots(figsize=(10, 10), layout="tight")
    axes.imshow(mosaic.cpu().numpy())
    end, y = _MARGIN + _BAR / pixel_size, rows * ks - _MARGIN
    axes.plot([_MARGIN, end], [y, y], color="white", clip_on=False)
    axes.text(end + 5, y, f"{1000 * _BAR:.0f} µm", color="white", va="center")
    axes.set_axis_off()
    if save_name is None:
        return figure, axes
    figure.savefig(save_name, dpi=300, bbox_inches="tight", pad_inches=0)
    pyplot.close(figure)
    return None
