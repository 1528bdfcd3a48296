"""``defocus help``: the reference, one topic at a time."""

from __future__ import annotations

from importlib.resources import files

import click

from defocus_cli.options.shared import GroupedCommand
from defocus_cli.words import console
from defocus_core.errors import UsageProblem, did_you_mean

TOPICS = {
    "conventions": "the formula, signs, units, kinds of output, colour, files",
    "look": "blades, mirrors, ovals, cat's eyes, axial colour, clipped lights, dual pixels, noise",
    "photo": "photographs with estimated depth, choosing focus by clicks, phones, hair",
    "depth": "depth files by format, options, repair, hidden layers",
    "quality": "accuracy, time and memory, verification, limits",
    "batch": "jobs files, sweeps, random lenses, resuming, clusters, data sets",
    "shots": "numbered frames, focus pulls, lenses from metadata, no flicker",
    "fit": "find the lens that blurs one picture to another, from their depth",
    "compare": "compare pictures with references: rules, causes, reports, pytest, CI",
    "python": "the library: files, lenses, training, batches, comparison",
    "json": "the documents that --json prints, field by field",
    "exit-codes": "exit codes, error lines, completion",
    "cite": "how to cite defocus and what it is built on",
}


@click.command("help", cls=GroupedCommand)
@click.argument("topic", required=False)
def command(topic: str | None) -> None:
    """Print the reference on TOPIC; without TOPIC, list the topics.

    For the options of a command, use 'defocus COMMAND --help', or 'defocus COMMAND --help-all' for
    all of them.

    \b
    Examples:
      defocus help
      defocus help depth
    """  # noqa: D301  click reads the backspace
    if topic is None:
        for name, subject in TOPICS.items():
            console.stdout(f"{name:<13}{subject}")
        return
    if topic not in TOPICS:
        others = f"topics are {', '.join(TOPICS)}; for a command, add --help to it"
        remedy = did_you_mean(topic, tuple(TOPICS), others)
        raise UsageProblem("unknown-name", "no such topic", remedy, path=topic)
    console.require_stdout()
    # Without a terminal, click prints the text as it is.
    click.echo_via_pager(text(topic).removesuffix("\n"))


def text(topic: str) -> str:
    """The text of a topic, in Markdown."""
    return (files("defocus_cli") / "help" / f"{topic}.md").read_text(encoding="utf-8")
