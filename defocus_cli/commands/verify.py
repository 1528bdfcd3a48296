"""``defocus verify``: measure the laws of the lens on this machine."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from defocus_cli.options import shared
from defocus_cli.options.types import GroupedCommand
from defocus_cli.words import console
from defocus_cli.words import verify as verify_table
from defocus_core.batch.jobs.job import Machine
from defocus_core.batch.rendering import job_steps
from defocus_core.system.process import set_to_render
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.evaluation.law_checks import Check


@click.command("verify", cls=GroupedCommand)
@shared.machine_options
@shared.json_option
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
    job_steps.load()
    import torch

    from defocus_core.evaluation.law_checks import Setting
    from defocus_core.evaluation.lens_laws import LAWS, verify

    device = job_steps.choose_device(machine.device)
    set_to_render()
    start = time.perf_counter()
    checks: list[Check] = []
    with console.bar("law", len(LAWS)) as laws:
        for law_checks in verify(Setting(device, machine.quality, machine.threads)):
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
            checks=[verify_table.record(check) for check in checks],
        )
    else:
        for line in verify_table.lines(checks):
            console.stdout(line)
        work = f"{device}, {machine.quality}, {counted(machine.threads, 'thread')}"
        console.stdout(f"{verify_table.summary(checks, seconds)} ({work})")
    return 0 if ok else 1
