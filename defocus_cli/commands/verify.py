"""``defocus verify``: check the laws of the lens on this machine."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from defocus_cli.options.job import machine_options
from defocus_cli.options.shared import GroupedCommand, json_option
from defocus_cli.words import console
from defocus_core.picture import plain_path
from defocus_core.request.job import Machine
from defocus_core.system.process import set_to_render
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.evaluation.lens_laws import Check

_LINE = "{:13}  {:53}  {:>8}  {:>8}  {:4}  {}"


@click.command("verify", cls=GroupedCommand)
@machine_options("quality", "device", "threads")
@json_option
def command(machine: Machine, as_json: bool) -> int:
    """Check on this machine that rendered pictures obey the laws of a lens.

    Small pictures are rendered in some seconds, and a table shows for each law the worst value that
    was measured, and its bound. The laws: white stays white; a point is a disc of the right radius;
    pixels in focus stay sharp; near surfaces cover far ones; the mean of left and right is the
    render; tiles leave no seam; gradients are right; CPU and GPU agree.

    The exit code is 0 if all laws hold, 1 if one fails.

    \b
    Examples:
      defocus verify
      defocus verify --quality high --device cuda
      defocus verify --json | jq '.checks[] | select(.ok | not)'
    """  # noqa: D301  click reads the backspace
    plain_path.load()
    import torch

    from defocus_core.evaluation.lens_laws import LawSetting, verify

    device = plain_path.choose_device(machine.device)
    set_to_render()
    start = time.perf_counter()
    checks: list[Check] = []
    say = (lambda line: None) if as_json else console.stdout
    say(_LINE.format("law", "measured", "worst", "bound", "unit", "").rstrip())
    for check in verify(LawSetting(device, machine.quality, machine.threads)):
        checks.append(check)
        say(_line(check))
    seconds = time.perf_counter() - start
    failed = sum(not check.ok for check in checks)
    if as_json:
        console.print_json(
            device=device,
            quality=machine.quality,
            threads=machine.threads,
            torch=torch.__version__,
            seconds=round(seconds, 3),
            ok=not failed,
            checks=[_record(check) for check in checks],
        )
    measured = sum(check.value is not None for check in checks)
    verdict = f"{failed} of {measured} FAILED" if failed else f"all {measured} hold"
    work = f"{device}, {machine.quality}, {counted(machine.threads, 'thread')}"
    say(f"{verdict}, {seconds:.1f} s ({work})")
    return 1 if failed else 0


def _line(check: Check) -> str:
    """The row of the table for a check."""
    value = "-" if check.value is None else f"{check.value:.2g}"
    verdict = "skipped: no GPU in use" if check.value is None else "ok" if check.ok else "FAILED"
    return _LINE.format(check.law, check.measured, value, f"{check.bound:.2g}", check.unit, verdict)


def _record(check: Check) -> dict[str, Any]:
    """The record of a check for JSON, where a value not finite or not measured is null."""
    value = check.value if math.isfinite(check.value or 0.0) else None
    return asdict(check) | {"value": value, "ok": check.ok, "skipped": check.value is None}
