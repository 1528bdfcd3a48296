"""The rendering rate of this machine, measured once and kept.

One picture that is made for it is rendered. The rate is kept in ``$XDG_CACHE_HOME/defocus`` or
``~/.cache/defocus``, for one version of defocus and of PyTorch, one device and one number of
threads.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path

from defocus_cli.system.console import say, version
from defocus_cli.system.errors import InputError
from defocus_cli.system.process import set_to_render
from defocus_cli.system.safe_files import written_whole

# Kind, height, width and largest CoC radius in px of the picture: all steps of rendering are in it.
_SCENE = ("thin", 540, 960, 16.0)
_REPEATS = 3  # the fastest counts: a machine is never faster than it is


def work_per_second(device: str, threads: int) -> float:
    """The rate that was measured before, or is measured now, kept, and said so."""
    found = kept(device, threads)
    if found is None:
        say(f"measuring this machine once, a second or two; kept in {_file(device, threads)}")
        found = measured(device, threads)
        keep(found, device, threads)
    return found


def kept(device: str, threads: int) -> float | None:
    """The rate that was measured before and still holds; None if there is none."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        document = json.loads(_file(device, threads).read_text(encoding="utf-8"))
        if document["key"] == _key(device, threads) and document["work_per_second"] > 0:
            return float(document["work_per_second"])
    return None


def keep(rate: float, device: str, threads: int) -> None:
    """Write a rate for later; where that fails, the machine is measured each time."""
    document = {"key": _key(device, threads), "work_per_second": rate}
    try:
        with written_whole(_file(device, threads)) as file:
            file.write((json.dumps(document, indent=1) + "\n").encode())
    except InputError as error:
        say(f"warning: {error.format_message()}; the machine is measured each time")


def measured(device: str, threads: int) -> float:
    """Render the picture some times; units of work in a second."""
    import torch

    from defocus_core import Stream, cost, scenery

    set_to_render()
    scene = [part.to(device) for part in scenery(*_SCENE)]
    seconds, stream = [], None
    for _ in range(_REPEATS + 1):  # the first is for what a process does once
        start = time.perf_counter()
        stream = Stream(scene[0], scene[1], threads=threads)
        for _ in stream.regions():
            pass
        if device == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    assert stream is not None
    return cost(stream).work / min(seconds[1:])


def _file(device: str, threads: int) -> Path:
    root = os.environ.get("XDG_CACHE_HOME", "")
    folder = Path(root) if Path(root).is_absolute() else Path.home() / ".cache"
    return folder / "defocus" / f"rate-{device}-{threads}.json"


def _key(device: str, threads: int) -> dict[str, object]:
    """What a rate holds for."""
    import torch

    name = torch.cuda.get_device_name() if device == "cuda" else "cpu"
    machine = {"device": name, "threads": threads, "torch": torch.__version__}
    return {"defocus": version(), **machine}
