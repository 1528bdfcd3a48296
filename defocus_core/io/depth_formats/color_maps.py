"""Depth that was drawn in colours: the maps of matplotlib by which it usually is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Nine colours of each map at even steps, sRGB.
_MAPS = {
    "viridis": "440154 472d7b 3b528b 2c728e 21918c 27ad81 5cc863 aadc32 fde725",
    "inferno": "000004 210c4a 57106e 8a226a bc3754 e35933 f98c0a f9c932 fcffa4",
    "magma": "000004 1d1147 51127c 832681 b73779 e55064 fb8761 fec287 fcfdbf",
    "plasma": "0d0887 4c02a1 7e03a8 aa2395 cc4778 e56b5d f89441 fdc328 f0f921",
    "turbo": "30123b 466be3 28bceb 32f298 a4fc3c ecd13a fb8122 d23105 7a0403",
    "jet": "000080 0000ff 0080ff 16ffe1 7dff7a e1ff16 ff9800 ff2200 800000",
    "Spectral": "9e0142 dd4a4c f98e52 fed481 ffffbe d8ef9b 89d0a4 3f97b7 5e4fa2",
}
# Levels of 8 bits that a colour may be away from its map, by few steps and a codec; the share of
# pixels that are near; steps between the colours of the table.
_NEAR, _MOST, _STEPS = 30, 0.95, 8


def color_map_of(pixels: NDArray[Any]) -> str:
    """The map that colours [N, 3] of 8 bits are drawn in; empty if it is not sure."""
    for name, words in _MAPS.items():
        colors = np.array([list(bytes.fromhex(word)) for word in words.split()], float)
        at = np.linspace(0, len(colors) - 1, (len(colors) - 1) * _STEPS + 1)
        line = np.stack([np.interp(at, range(len(colors)), c) for c in colors.T], axis=1)
        away = np.abs(pixels[:, None].astype(float) - line).max(axis=2).min(axis=1)
        if np.mean(away <= _NEAR) >= _MOST:
            return name
    return ""
