"""What a picture asks of a device is what the help says."""

from pathlib import Path

import pytest

from defocus_core.bench.launches import cases_in, counted, names, table, with_table

HELP = Path(__file__).parents[3] / "defocus_cli" / "help" / "quality.md"
WRITTEN = {case.name: case for case in cases_in(HELP.read_text())}
# Of each number; those of one digit round by more.
WITHIN, ROUNDING = 0.03, 0.06


def test_the_help_has_each_picture():
    assert list(WRITTEN) == names()


@pytest.mark.parametrize("name", names())
def test_counts_are_those_of_the_help(name):
    found, written = counted(name), WRITTEN[name]
    for one, other in zip(
        (*found.alone, *found.pair), (*written.alone, *written.pair), strict=True
    ):
        assert one == pytest.approx(other, rel=WITHIN, abs=ROUNDING)
    assert found.pair[0] <= 1.4 * found.alone[0], "left and right are seen with the centre"


def test_a_table_takes_the_place_of_the_old_one():
    lines = list(table(WRITTEN.values()))
    text = "\n".join(["before", "", *lines, "", "after", ""])
    changed = [case._replace(pair=case.alone) for case in WRITTEN.values()]
    other = with_table(text, list(table(changed)), HELP)
    assert [case.name for case in cases_in(other)] == names()
    assert cases_in(other)[0].pair == cases_in(text)[0].alone
    assert with_table(other, lines, HELP) == text
