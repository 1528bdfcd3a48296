"""What a picture asks of a device is what the help says, counted on a pretended one of 8 GB."""

from pathlib import Path

import pytest
import torch
from launches import Launches
from pretended_device import NAME, pretended, there

from defocus_core import render

HELP = Path(__file__).parents[4] / "defocus_cli" / "help" / "quality.md"
ROWS = [row for row in HELP.read_text().splitlines() if "×" in row and row[0] == "|"]
NAMES = [f"{kind} {size}" for kind in ("floor", "cards") for size in ("960×540", "1920×1080")]
# Greatest radius of blur in px; and the number of cards, and px of radius between them.
RADIUS, CARDS, STEP = 32.0, 12, 5.0
# Of each number; those of one digit round by more.
WITHIN, ROUNDING = 0.03, 0.06


def scene(kind, height, width):
    """Noise of colour on a floor through the focus, or on cards before a wall: image and radii."""
    image = torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))
    if kind == "floor":
        rows = RADIUS * (1 - 2 * torch.linspace(0, 1, height))
        return image, rows[:, None].expand(height, width).contiguous()
    radius = torch.full((height, width), RADIUS - 4)
    h, w = height // 4, width // 6
    for number in range(CARDS):
        top, left = (number * 137) % (height - h), (number * 271) % (width - w)
        radius[top : top + h, left : left + w] = RADIUS - 4 - STEP * number
    return image, radius


def counted(name):
    """What a picture of the table asks for, and what it does with left and right."""
    kind, size = name.split()
    width, height = map(int, size.split("×"))
    asked = []
    for left_right in (False, True):
        image, radius = scene(kind, height, width)
        with pretended():
            image, radius = there(image), there(radius)
            with Launches(NAME) as counts:
                render(image, radius, left_right=left_right)
        asked.append(counts)
    return asked


def row_of(name, asked):
    """A row of the table."""
    cells = (
        f"{counts.launches:,}".replace(",", " ") + f" | {counts.waits} | {counts.written / 1e9:.1f}"
        for counts in asked
    )
    return f"| {name} | {' | '.join(cells)} |"


def numbers(row):
    return [float(cell.replace(" ", "")) for cell in row.split("|")[2:-1]]


def test_the_help_has_each_picture():
    assert [row.split("|")[1].strip() for row in ROWS] == NAMES


@pytest.mark.parametrize(
    ("name", "written"),
    [
        pytest.param(*row, id=row[0], marks=[pytest.mark.bench] * ("1080" in row[0]))
        for row in zip(NAMES, ROWS, strict=True)
    ],
)
def test_counts_are_those_of_the_help(name, written):
    alone, pair = counted(name)
    found = row_of(name, (alone, pair))
    assert numbers(found) == pytest.approx(numbers(written), rel=WITHIN, abs=ROUNDING), found
    assert pair.launches <= 1.4 * alone.launches, "left and right share the centre"
