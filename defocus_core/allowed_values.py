"""Values of renderer options, for modules that must not load torch."""

from __future__ import annotations

QUALITIES = ("standard", "high", "reference")
DUAL_PIXEL_MODELS = ("split", "smooth")
# Measured sensors: model, crosstalk, and the source of the measurement.
DUAL_PIXEL_SENSORS = {
    "@pixel4": ("smooth", 0.08, "Pixel 4, fitted to photographs of S. Xin et al., ICCV 2021"),
    "@canon-dpp": (
        "smooth",
        0.335,
        "Canon R6 II with RF 50 mm at f/4, fitted to a plane of Sdirt, C. He et al., ICCV 2025: "
        "views made by Canon's DPP, closer together than those of its photodiodes",
    ),
}
# Automatic highlights: threshold in linear light, and gain.
AUTO_LIGHTS = (0.93, 8.0)
DEPTH_REPAIRS = ("auto", "off")
MIN_TILE = 16  # least px on a side of a tile: a block of the index of slices
WIDEST_EDGE = 100  # greatest width in px of a soft edge of depth; a wider one is a surface
