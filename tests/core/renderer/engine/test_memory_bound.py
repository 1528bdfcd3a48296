"""The bound of a rendering's memory: it grows with what is held, and nothing takes more."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[3] / "support"
# Renders scenes in a process of its own, and prints the most that each held beyond what it began
# with, in bytes, and the bound.
_PEAK = """
import sys, torch
from defocus_core.renderer.engine.memory_bound import memory_bound
from synthetic_scenes import KINDS, scenery
from renderers import renderer_of
from defocus_core.system import memory
from peak_memory import peak_mb, reset_peak

torch.set_num_threads(1)
memory.share_heap()
def measured(case):
    kind, height, width, radius, quality, pair, threads, channels = case.split()
    threads, views = int(threads), pair == "pair"
    options = dict(quality=quality, left_right=views, threads=threads)
    small = scenery(kind, 64, 96, 4.0)
    for _ in renderer_of(small[0], small[1], **options).tiles():
        pass
    image, radii = scenery(kind, int(height), int(width), float(radius))[:2]
    image = torch.cat([image, image])[: int(channels)]
    memory.trim()
    reset_peak()
    before = memory.held_mb()
    renderer = renderer_of(image, radii, **options)
    bound = memory_bound(renderer, threads)
    for _ in renderer.tiles():
        pass
    print(1e6 * (peak_mb() - before), bound)

for case in sys.argv[1:]:
    measured(case)
"""
# Kind, height, width, radius, quality, views, threads and channels.
_CASES = (
    *("thin 256 384 16 high centre 2 3", "cards 384 576 30 standard centre 1 3"),
    *("lights 480 800 12 standard pair 1 3", "floor 720 1280 24 standard centre 2 3"),
    "cards 1200 1800 30 standard pair 1 4",
)


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="not on this system: no peak to reset"
)
def test_no_rendering_takes_more_memory_than_its_bound():
    command = [sys.executable, "-c", _PEAK, *_CASES]
    environment = {**os.environ, "PYTHONPATH": str(SUPPORT)}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    for case, line in zip(_CASES, ran.stdout.splitlines(), strict=True):
        peak, bound = map(float, line.split())
        assert peak <= bound, case
        # less the code of compiled loops, which this process holds already
        assert bound - 150e6 < 6 * peak, f"a bound that says nothing helps nobody: {case}"
