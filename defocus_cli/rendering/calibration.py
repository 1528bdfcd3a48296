"""The rendering rate of this machine, measured on a made picture before a forecast."""

from __future__ import annotations

import time
from functools import cache

from defocus_cli.system.process import set_to_render

# Kind, height, width and largest CoC radius in px of the picture: all steps of rendering are in it.
_SCENE = ("thin", 540, 960, 16.0)
_REPEATS = 2  # the fastest counts: a machine is never faster than it is


@cache
def work_per_second(device: str, threads: int) -> float:
    """Units of work in a second: a second or two to measure, which torch takes to be imported."""
    import torch

    from defocus_core import Settings, Stream, cost, scenery

    set_to_render()
    image, radius = (part.to(device) for part in scenery(*_SCENE)[:2])
    seconds = []
    for _ in range(_REPEATS + 1):  # the first is for what a process does once
        start = time.perf_counter()
        stream = Stream(image, radius, Settings(threads=threads))
        for _ in stream.regions():
            pass
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return cost(stream).work / min(seconds[1:])
