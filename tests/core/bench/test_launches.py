"""What a picture asks of a device is what the help says."""

from pathlib import Path

import pytest

from defocus_core.bench.launches import Counted, CountedCase, counted, line, names, with_table

HELP = Path(__file__).parents[3] / "defocus_cli" / "help" / "quality.md"
ROWS = [row for row in HELP.read_text().splitlines() if "×" in row and row[0] == "|"]
# Of each number; those of one digit round by more.
WITHIN, ROUNDING = 0.03, 0.06


def test_the_help_has_each_picture():
    assert [row.split("|")[1].strip() for row in ROWS] == names()


@pytest.mark.parametrize(("name", "written"), [*zip(names(), ROWS, strict=True)], ids=names())
def test_counts_are_those_of_the_help(name, written):
    found = counted(name)
    assert numbers(line(found)) == pytest.approx(numbers(written), rel=WITHIN, abs=ROUNDING)
    assert found.pair.launches <= 1.4 * found.alone.launches, "left and right share the centre"


def numbers(row):
    return [float(cell.replace(" ", "")) for cell in row.split("|")[2:-1]]


def test_a_table_takes_the_place_of_the_old_one():
    case = CountedCase("floor 9×5", Counted(890, 13, 1.25), Counted(1_100, 14, 2.0))
    text = with_table(None, [case, case], HELP)
    other = with_table(f"before\n\n{text}\nafter\n", [case], HELP)
    assert other == f"before\n\n{with_table(None, [case], HELP)}\nafter\n"
