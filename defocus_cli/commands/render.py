"""``defocus render``: defocus pictures, given their colour and depth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from defocus_cli.options import job as job_options
from defocus_cli.options.shared import (
    FilePath,
    GroupedCommand,
    check_inputs_option,
    json_option,
    option,
    verbose_option,
)
from defocus_cli.words import console
from defocus_cli.words.batch import carry_out
from defocus_core.batch.workers import pipeline
from defocus_core.batch.workers.run import Execution
from defocus_core.errors import UsageProblem
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading, of_views
from defocus_core.request.job_options import MACHINE_OPTIONS
from defocus_core.request.lens import LensValues
from defocus_core.request.output_kinds import KINDS
from defocus_core.request.pairing import find
from defocus_core.request.picture_lenses import PictureLenses

_KINDS = "\n".join(f"  {kind.name:<13} {kind.help}" for kind in KINDS.values())
_HELP = f"""Defocus the picture COLOR, whose distances are in DEPTH, as a lens would.

COLOR and DEPTH are two files. They may be two directories, whose files pair up by stem: a/x.png
with b/x.exr. They may be patterns like 'shot.####.exr' for the frames of a shot ('defocus help
shots'). Without DEPTH, each colour file must hold depth, too, as an EXR or a photograph of a phone
can.

The outputs are OUT/<kind>/<stem>.<ext>; <stem> is the name of the colour file without its suffix.
--view left,right renders two views of an EXR, whose names are added to the stem.

OUT/journal.jsonl records finished pictures. The same command, given again, renders only what is
missing, and pictures whose inputs, options or outputs changed. Pictures of another lens, and files
that are not in the journal, are not replaced: give another OUT for them.

\b
Kinds:
{_KINDS}

\b
Examples:
  defocus render rgb.exr depth.exr -o out --focal-length 50mm --fnumber 1.4 --focus 2m
  defocus render photo.jpg depth_mm.png -o out --lens 50mm.toml --focus-at 640,360 --format png
  defocus render frames/ depths/ -o out --lens 50mm.toml --outputs render,left,right,coc
  defocus render scene.exr -o out --lens 50mm.toml --focus inf --blades 6 --preview
  defocus render frames/ depths/ -o out --lens 50mm.toml --dry-run
  defocus render 'rgb.####.exr' 'z.####.exr' -o out --focal-length 50mm --animate pull.csv
"""


@click.command("render", cls=GroupedCommand, help=_HELP)
@click.argument("color", type=FilePath())
@click.argument("depth", type=FilePath(), required=False)
@job_options.shot_lens_options(required=True)
@job_options.shot_options
@job_options.output_options
@job_options.others_options
@job_options.reading_options(lambda row: True)
@job_options.machine_options(*MACHINE_OPTIONS)
@check_inputs_option
@json_option
@verbose_option
@option(
    "--dry-run",
    "Open the inputs, and print the files to read and write and the memory needed; render nothing.",
)
def command(
    color: Path,
    depth: Path | None,
    lenses: PictureLenses,
    shot: job_options.ShotOptions,
    outputs: Outputs,
    others: dict[str, tuple[Path, Path | None]],
    reading: Reading,
    machine: Machine,
    check_inputs: str,
    as_json: bool,
    verbose: bool,
    dry_run: bool,
) -> None:
    """Render the pictures that are not finished yet, and report."""
    pictures, every = find(color, depth, others, frames=shot.frames)
    if not lenses.is_complete:
        from defocus_core.picture.subject import with_blur_and_focus

        typed = click.get_current_context().meta["typed"]
        lenses, reading = with_blur_and_focus(lenses, pictures, reading, typed)
    jobs = [
        Job(picture, lens, reading, outputs, machine)
        for picture, lens in _with_lenses(pictures, lenses, verbose=verbose)
    ]
    if every or shot.together:
        from defocus_core.request.shots import with_shot

        moving = lenses.moves_focus
        jobs = with_shot(
            jobs, every, lambda p, _: lenses.lens_of(p)[0], shot.together, moving=moving
        )
    jobs = of_views(jobs)
    if outputs.file and (len(jobs) > 1 or shot.contact is not None):
        problem = "is one file, which does not hold several pictures"
        raise UsageProblem("contradiction", problem, "name a directory", path=jobs[0].written[0])
    execution = Execution(
        pipeline.execute,
        read_inputs=check_inputs == "hash",
        keep_lenses=True,
        raises=len(jobs) == 1,
    )
    carry_out(
        jobs,
        outputs.root,
        execution,
        dry_run=dry_run,
        contact=shot.contact,
        as_json=as_json,
        verbose=verbose,
    )


def _with_lenses(
    pictures: Sequence[PictureFiles], lenses: PictureLenses, *, verbose: bool
) -> Iterator[tuple[PictureFiles, LensValues]]:
    """Each picture and its lens; if ``verbose``, print options from metadata when they change."""
    said: object = None
    for picture in pictures:
        lens, metadata = lenses.lens_of(picture)
        if verbose and metadata and metadata != said:
            named = (f"{n} {x.text} ({x.place.field})" for n, x in metadata.items())
            words = ", ".join(named)
            console.stderr(f"{picture.color}: {words}")
            said = metadata
        yield picture, lens
