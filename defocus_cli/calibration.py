"""How long this machine takes for what a plan counts, measured once and kept.

Some small scenes are rendered. Seconds and bytes for each unit of work are what explains their
times and their memory best. They are kept in ``$XDG_CACHE_HOME/defocus`` or ``~/.cache/defocus``,
and hold for one version of defocus and of PyTorch, one device and one number of threads.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli import memory
from defocus_cli.errors import InputError
from defocus_cli.files import written_whole
from defocus_cli.fitting import nonnegative
from defocus_cli.process_settings import set_to_render
from defocus_cli.report import say, version
from defocus_cli.scene_rendering import Rendered, rendered_scene

if TYPE_CHECKING:
    from defocus_core.planning import Plan

# Kind, width, height, radius, quality, whether left and right too: all that a plan counts is much
# of one of them.
_SCENES = (
    ("focus", 256, 256, 3.0, "draft", False),
    ("focus", 1024, 640, 3.0, "draft", True),
    ("plane", 256, 256, 24.0, "standard", True),
    ("plane", 576, 384, 3.0, "high", False),
    ("plane", 768, 512, 96.0, "standard", False),
    ("floor", 256, 256, 3.0, "high", False),
    ("floor", 256, 256, 24.0, "standard", False),
    ("floor", 384, 256, 96.0, "standard", False),
    ("floor", 384, 256, 10.0, "standard", True),
    ("floor", 1920, 1080, 12.0, "standard", False),
    ("cards", 128, 128, 24.0, "high", False),
    ("cards", 768, 512, 10.0, "draft", False),
    ("cards", 384, 256, 96.0, "standard", False),
    ("cards", 576, 384, 48.0, "standard", True),
    ("cards", 1408, 832, 3.0, "standard", False),
    ("thin", 384, 256, 64.0, "standard", False),
    ("thin", 576, 384, 10.0, "standard", False),
    ("lights", 128, 128, 24.0, "high", False),
    ("lights", 576, 384, 96.0, "standard", False),
    ("lights", 384, 256, 10.0, "standard", False),
    ("most", 1024, 640, 24.0, "draft", True),
    ("most", 256, 256, 64.0, "standard", False),
    ("most", 384, 256, 24.0, "high", False),
    ("most", 1408, 832, 3.0, "standard", True),
    ("most", 1920, 1080, 48.0, "standard", False),
    ("most", 576, 384, 64.0, "standard", False),
)
_REPEATS = 2  # the faster counts: a machine is never faster than it is
_LEAST_MB = 8.0  # the allocator rounds what is less
# Seconds for each load and bytes held for each byte planned, as on the machine of a developer: what
# the scenes leave open is taken from there. Memory hardly depends on the machine.
_USUAL_SECONDS = {
    **{"frame": 5e-4, "pixels": 5e-9, "images": 2.5e-9, "doubled": 8e-9, "backdrop": 1e-8},
    **{"kernels": 1.2e-10},
    **{"regions": 4e-3, "around": 3e-9, "slopes": 6e-8, "edges": 2.2e-6, "behind": 3e-7},
    **{"lights": 2e-8, "calls": 6e-5, "averaged": 4e-9, "forward": 1.5e-10},
    **{"products": 6e-10, "inverse": 1.2e-10, "composited": 2.5e-9, "finished": 6e-9},
}
_USUAL_BYTES = {
    **{"backdrop": 2.0, "spectra": 1.2, "making": 0.8, "region": 3.0, "layers": 1.0},
    **{"discs": 1.2, "result": 1.5, "tile": 2.0, "cells": 1.5},
}
_TRUST = 0.2  # in that, where a scene has 1


@dataclass(frozen=True)
class Calibration:
    """What each unit of work takes.

    Attributes:
        seconds: for a unit of each load of a plan.
        bytes: held for each byte of a plan.
        threads: that did the work.
    """

    seconds: Mapping[str, float]
    bytes: Mapping[str, float]
    threads: int

    def predicted_seconds(self, plan: Plan) -> float:
        """How long a planned rendering takes."""
        loads = _loads(plan, self.threads)
        return sum(self.seconds[name] * load for name, load in loads.items())

    def predicted_mb(self, plan: Plan, at_once: int | None = None) -> float:
        """What a planned rendering takes of memory beyond what was held before, in MB.

        Args:
            plan: the rendering.
            at_once: regions that are computed at once at most; None for as many as threads.
        """
        held = _bytes(plan, self.threads, at_once or self.threads)
        return sum(self.bytes[name] * size for name, size in held.items()) / memory.MB


def usual(threads: int) -> Calibration:
    """What memory takes, unless this machine has told otherwise; seconds are not known."""
    return Calibration({}, _USUAL_BYTES, threads)


def kept(device: str, threads: int) -> Calibration | None:
    """What was measured before and still holds; None if there is none."""
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        document = json.loads(_file(device, threads).read_text(encoding="utf-8"))
        if document["key"] == _key(device, threads):
            seconds, held = (
                {str(name): float(value) for name, value in document[part].items()}
                for part in ("seconds", "bytes")
            )
            return Calibration(seconds, held, threads)
    return None


def calibrated(device: str, threads: int) -> Calibration:
    """What was measured before, or is measured now, kept, and said so."""
    found = kept(device, threads)
    if found is None:
        file = _file(device, threads)
        say(f"measuring this machine once, some seconds; kept in {file}")
        found = measured(device, threads)
        keep(found, device)
    return found


def keep(calibration: Calibration, device: str) -> None:
    """Write for later what was measured; a machine that forbids it is measured each time."""
    threads = calibration.threads
    document = {"key": _key(device, threads), "seconds": dict(calibration.seconds)}
    document["bytes"] = dict(calibration.bytes)
    try:
        with written_whole(_file(device, threads)) as file:
            file.write((json.dumps(document, indent=1) + "\n").encode())
    except InputError as error:
        say(f"warning: {error.format_message()}; the machine is measured each time")


def measured(device: str, threads: int) -> Calibration:
    """Render the scenes and find what explains their times and their memory."""
    from defocus_core.planning import plan
    from defocus_core.scenery import scenery

    set_to_render()
    plans, seconds, peaks = [], [], []
    for number, (kind, width, height, radius, quality, pair) in enumerate((_SCENES[-1], *_SCENES)):
        scene = scenery(kind, height, width, radius)
        scene = type(scene)(*(part.to(device) for part in scene))
        settings: dict[str, Any] = {"quality": quality, "left_right": pair}
        work = partial(rendered_scene, scene, threads=threads, **settings)
        took = [_cost(work, device, threads) for _ in range(_REPEATS)]
        if number:  # the first is for what a process does once
            plans.append(plan(scene.signed_radius, image=scene.image, **settings))
            seconds.append(min(second for second, _ in took))
            kept_mb = (3 if pair else 1) * scene.image.nbytes / memory.MB
            peaks.append(max(peak for _, peak in took) - kept_mb)
    loads = [_loads(each, threads) for each in plans]
    held = [_bytes(each, threads, threads) for each in plans]
    return Calibration(
        _fitted(loads, seconds, _USUAL_SECONDS),
        _fitted(held, [max(peak, _LEAST_MB) * memory.MB for peak in peaks], _USUAL_BYTES),
        threads,
    )


def _fitted(
    amounts: Sequence[Mapping[str, float]], goals: Sequence[float], usual: Mapping[str, float]
) -> dict[str, float]:
    """What each unit of the amounts takes, so that all together they take what was measured."""
    rows = [[each[name] for name in usual] for each in amounts]
    found = nonnegative(rows, goals, list(usual.values()), _TRUST)
    return dict(zip(usual, found, strict=True))


def _cost(work: Callable[[], Rendered], device: str, threads: int) -> tuple[float, float]:
    """Seconds, and MB beyond what was held before.

    One thread on a CPU is asked for its own seconds: what else the machine does meanwhile is left
    out.
    """
    import torch

    clock = time.process_time if (device, threads) == ("cpu", 1) else time.perf_counter
    memory.reset_peak(device)
    before, start = memory.held_mb(device), clock()
    work()
    if device == "cuda":
        torch.cuda.synchronize()
    seconds = clock() - start
    return seconds, (memory.peak_mb(device) or 0.0) - before


def _loads(plan: Plan, threads: int) -> dict[str, float]:
    """Loads, as many times as threads that have nothing to do wait for the others."""
    regions = _at_once(plan, threads)
    busy = round(plan.of_regions["regions"]) or 1  # the others are copies
    rounds = -(-busy // regions) / busy * threads
    tiles, each = max(1.0, plan.tiles / plan.regions), threads // regions
    of_tiles = rounds * math.ceil(tiles / each) / tiles
    return {
        name: load + rounds * plan.of_regions[name] + of_tiles * plan.of_tiles[name]
        for name, load in plan.of_frame.items()
    }


def _bytes(plan: Plan, threads: int, at_once: int) -> dict[str, float]:
    """Bytes that are held at once."""
    from defocus_core.threads import AHEAD

    regions = min(_at_once(plan, threads), at_once)
    tiles = regions * min(threads // regions, math.ceil(plan.tiles / plan.regions))
    waiting = min(plan.regions, (1 + AHEAD) * regions)
    times = dict.fromkeys(("region", "layers", "discs"), regions)
    times |= {"result": waiting, "tile": tiles, "making": tiles}  # none waits for a kernel
    return {name: size * times.get(name, 1) for name, size in plan.bytes.items()}


def _at_once(plan: Plan, threads: int) -> int:
    """Regions that are computed at once."""
    return min(threads, plan.regions)


def _file(device: str, threads: int) -> Path:
    root = os.environ.get("XDG_CACHE_HOME", "")
    folder = Path(root) if Path(root).is_absolute() else Path.home() / ".cache"
    return folder / "defocus" / f"calibration-{device}-{threads}.json"


def _key(device: str, threads: int) -> dict[str, object]:
    """What a calibration holds for."""
    import torch

    name = torch.cuda.get_device_name() if device == "cuda" else "cpu"
    machine = {"device": name, "threads": threads, "torch": torch.__version__}
    return {"defocus": version(), "core": _core(), **machine}


@cache
def _core() -> str:
    """A digest of the renderer: while it is worked on, its version says too little."""
    import defocus_core

    digest = hashlib.blake2b(digest_size=8)
    for source in sorted(Path(defocus_core.__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()
