"""``defocus verify``: measure the laws of the lens on this machine."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
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

_WORDS = {True: "ok", False: "FAILED"}


@click.command("verify", cls=GroupedCommand)
@machine_options("quality", "device", "threads")
@json_option
def command(machine: Machine, as_json: bool) -> int:
    """Render small pictures and measure whether the laws of the lens hold on this machine.

    A point becomes a disc of the right radius, place and energy with a sharp rim; white stays
    white; left and right make the whole; what is in focus stays; nearer covers farther; tiles,
    threads, flips and quarter turns change nothing; the gradient is right; CPU and GPU agree.

    It takes seconds. The exit code is 0 if all hold, 1 if one fails.

    \b
    Examples:
      defocus verify
      defocus verify --quality high --device cuda
      defocus verify --json | jq '.checks[] | select(.ok | not)'
    """  # noqa: D301  click reads the backspace
    plain_path.load()
    import torch

    from defocus_core.evaluation.lens_laws import LAWS, LawSetting, verify

    device = plain_path.choose_device(machine.device)
    set_to_render()
    start = time.perf_counter()
    checks: list[Check] = []
    with console.bar("law", len(LAWS)) as laws:
        for law_checks in verify(LawSetting(device, machine.quality, machine.threads)):
            checks += law_checks
            laws.update()
    seconds = time.perf_counter() - start
    ok = all(check.ok for check in checks)
    if as_json:
        console.print_json(
            device=device,
            quality=machine.quality,
            threads=machine.threads,
            torch=torch.__version__,
            seconds=round(seconds, 3),
            ok=ok,
            checks=[_record(check) for check in checks],
        )
    else:
        console.stdout(*_lines(checks))
        measured = [check for check in checks if check.value is not None]
        failed = sum(not check.ok for check in measured)
        verdict = f"{failed} of {len(measured)} FAILED" if failed else f"all {len(measured)} hold"
        work = f"{device}, {machine.quality}, {counted(machine.threads, 'thread')}"
        console.stdout(f"{verdict}, {seconds:.1f} s ({work})")
    return 0 if ok else 1


def _lines(checks: Sequence[Check]) -> Iterator[str]:
    """A heading, a line for each check, and how many failed."""
    law, measured = (
        max(len(text) for text in column)
        for column in zip(("law", "measured"), *((c.law, c.measured) for c in checks), strict=True)
    )
    yield f"{'law':{law}}  {'measured':{measured}}  {'worst':>8}  {'bound':>8}  unit"
    for check in checks:
        worst, verdict = "-", "skipped: no GPU in use"
        if check.value is not None:
            worst, verdict = f"{check.value:.2g}", _WORDS[check.ok]
        numbers = f"{worst:>8}  {check.bound:>8.2g}  {check.unit:5}"
        yield f"{check.law:{law}}  {check.measured:{measured}}  {numbers}  {verdict}"


def _record(check: Check) -> dict[str, Any]:
    """One check; a value that is no finite number is null, as is one that was not measured."""
    finite = check.value is not None and math.isfinite(check.value)
    return {
        **asdict(check),
        "value": check.value if finite else None,
        "ok": check.ok,
        "skipped": check.value is None,
    }
