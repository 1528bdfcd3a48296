"""Launches, waits and bytes of a picture on a device, counted on a pretended one of 8 GB.

`defocus bench --launches` writes the table of them into the help, and a test holds to it what is
counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

from defocus_core.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

SIZES = ((960, 540), (1920, 1080))
# Greatest radius of blur in px; and the number of cards, and px of radius between them.
_RADIUS, _CARDS, _STEP = 32.0, 12, 5.0
_KINDS = ("floor", "cards")
_HEADING = (
    "| | launches | waits | GB written | with left and right | waits | GB written |",
    "|---|---|---|---|---|---|---|",
)


class Counted(NamedTuple):
    """What a picture asks of a device."""

    launches: int
    waits: int
    gigabytes: float  # written


class CountedCase(NamedTuple):
    """A row of the table."""

    name: str
    alone: Counted
    pair: Counted  # with left and right


def names() -> list[str]:
    """The pictures of the table, in order."""
    return [f"{kind} {width}×{height}" for kind in _KINDS for width, height in SIZES]


def counted(name: str) -> CountedCase:
    """Count what a picture of the table asks for, and what it does with left and right."""
    from defocus_core.evaluation.cost import Launches
    from defocus_core.evaluation.pretended_device import NAME, pretended, there
    from defocus_core.renderer.render import render

    kind, size = name.split()
    width, height = map(int, size.split("×"))
    pair: list[Counted] = []
    for left_right in (False, True):
        image, radius = _scene(kind, height, width)
        with pretended():
            image, radius = there(image), there(radius)
            with Launches(NAME) as counts:
                render(image, radius, left_right=left_right)
        pair.append(Counted(counts.launches, counts.waits, counts.written / 1e9))
    return CountedCase(name, *pair)


def _scene(kind: str, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Noise of colour on a floor through the focus, or on cards before a wall: image and radii."""
    import torch

    image = torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))
    if kind == "floor":
        rows = _RADIUS * (1 - 2 * torch.linspace(0, 1, height))
        return image, rows[:, None].expand(height, width).contiguous()
    radius = torch.full((height, width), _RADIUS - 4)
    h, w = height // 4, width // 6
    for number in range(_CARDS):
        top, left = (number * 137) % (height - h), (number * 271) % (width - w)
        radius[top : top + h, left : left + w] = _RADIUS - 4 - _STEP * number
    return image, radius


def table(cases: Iterable[CountedCase]) -> Iterator[str]:
    """The lines of the table, in Markdown."""
    yield from _HEADING
    for case in cases:
        cells = [
            f"{counts.launches:,}".replace(",", " ") + f" | {counts.waits} | {counts.gigabytes:.1f}"
            for counts in (case.alone, case.pair)
        ]
        yield f"| {case.name} | {' | '.join(cells)} |"


def cases_in(text: str) -> list[CountedCase]:
    """The rows of the table in a text."""
    cases = []
    for line in _split(text)[1]:
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        numbers = [float(cell.replace(" ", "")) for cell in cells]
        pair = [Counted(int(n[0]), int(n[1]), n[2]) for n in (numbers[:3], numbers[3:])]
        cases.append(CountedCase(name, *pair))
    return cases


def with_table(text: str | None, lines: Sequence[str], path: Path) -> str:
    """The text of a file with a table in the place of the one that it holds; None has no text.

    Raises:
        InputError: If the text holds no table.
    """
    if text is None:
        return "\n".join([*lines, ""])
    if _HEADING[0] not in text.split("\n"):
        problem, remedy = "has no table of launches", "name a file that does, or a new one"
        raise InputError("malformed", problem, remedy, path=path)
    before, _, after = _split(text)
    return "\n".join([*before, *lines, *after])


def _split(text: str) -> tuple[list[str], list[str], list[str]]:
    """The lines before the table, those of its rows, and those after it."""
    lines = text.split("\n")
    first = lines.index(_HEADING[0])
    rows = list(takewhile(lambda line: line.startswith("|"), lines[first:]))
    return lines[:first], rows[len(_HEADING) :], lines[first + len(rows) :]
