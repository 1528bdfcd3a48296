"""Values that options of the renderer may have, for who names them without loading torch."""

from __future__ import annotations

QUALITIES = ("draft", "standard", "high", "reference")
DUAL_PIXEL_MODELS = ("split", "smooth")
# What automatic highlights stand for: threshold, in linear light, and gain.
AUTO_LIGHTS = (0.93, 16.0)
DEPTH_REPAIRS = ("auto", "off")  # or soft edges of a slope
LEAST_TILE = 16  # px of the side of a tile: that of a block of the index of slices
WIDEST_EDGE = 100  # px of a soft edge of depth; what is wider is a surface
