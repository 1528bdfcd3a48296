"""Compilation of all functions at once, when any of them is first used on a machine."""

from __future__ import annotations

from functools import cache
from logging import getLogger
from typing import Any

import numpy as np

from defocus_core.optics.outline import Disc
from defocus_core.renderer.compiled import back
from defocus_core.renderer.compiled.arrays import Statistics, samples_of
from defocus_core.renderer.compiled.bands import Bounds
from defocus_core.renderer.compiled.kept import folder, one_process
from defocus_core.renderer.compiled.look import look_at_depth, look_at_light
from defocus_core.renderer.compiled.shifts import may_be_shifted

_LOGGER = getLogger("defocus_core")
_SECONDS = 20
_SIZE = 32, 40  # (height, width) px of the picture of which each function renders something


@cache
def compile_once() -> None:
    """Compile the functions that are not cached yet, and log a message, as it takes a while."""
    with one_process() as is_due:
        if not is_due:
            return
        where = "" if folder() else ": no folder can be written to keep it"
        _LOGGER.warning("compiling the renderer once, which takes some %d s%s", _SECONDS, where)
        render_everything()


def render_everything() -> None:
    """Render a small picture that needs every compiled function."""
    x = np.linspace(-60, 60, _SIZE[1], dtype=np.float32)
    radius = np.where(np.arange(_SIZE[0])[:, None] % 16 < 8, x, -3)
    image = np.random.default_rng(0).random((3, *_SIZE), np.float32)
    look_at_light(image)
    look_at_depth(radius, 1)
    may_be_shifted(image, radius, np.float32(2))
    bounds = Bounds(np.array([[0, 1, 0, 1]] * 3, np.float32), 0.0, 0.0, 0.5, 1.0)
    channels = ((0.0, 1.0),) * len(image)
    samples = samples_of(image, radius, Statistics((-60.0, 60.0), True, 0.0, channels, 1.0))
    options: dict[str, Any] = {"outline": Disc(), "min_slope": 0.01, "threads": 1}
    back.render(samples, np.zeros((3, 3, 1, 0), np.float32), bounds, edges=True, **options)
