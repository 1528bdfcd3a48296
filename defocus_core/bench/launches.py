"""Launches, waits and bytes of a picture on a device, counted on a pretended one of 8 GB.

`defocus bench --launches` writes the table of them into the help, and a test holds to it what is
counted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
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
    "| | launches | waits | GB written | with left and right | waits | GB written |\n"
    "|---|---|---|---|---|---|---|"
)
_TABLE = re.compile(rf"{re.escape(_HEADING)}(?:\n\|.*)*")


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


def line(case: CountedCase) -> str:
    """A row of the table, in Markdown."""
    cells = (
        f"{counts.launches:,}".replace(",", " ") + f" | {counts.waits} | {counts.gigabytes:.1f}"
        for counts in (case.alone, case.pair)
    )
    return f"| {case.name} | {' | '.join(cells)} |"


def with_table(text: str | None, cases: Iterable[CountedCase], path: Path) -> str:
    """The text of a file with a table in the place of the one that it holds; None has no text.

    Raises:
        InputError: If the text holds no table.
    """
    table = "\n".join([_HEADING, *map(line, cases)])
    changed, count = (f"{table}\n", 1) if text is None else _TABLE.subn(table, text, 1)
    if not count:
        problem, remedy = "has no table of launches", "name a file that does, or a new one"
        raise InputError("malformed", problem, remedy, path=path)
    return changed
