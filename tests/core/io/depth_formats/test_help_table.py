"""The help topic on depth lists every format as the table has it."""

from command_line import topic

from defocus_core.io.depth_formats.table import ROWS


def facts(row):
    """What the line of a format must say, in this order."""
    yield ", ".join(f"`{name}`" for name in (row.name, *row.aliases))
    yield row.title.split("‹")[0]
    yield from ["px of radius"] * (row.rule == "radius")
    yield from [f"{row.scale if row.scale > 1 else 1 / row.scale:.8g}"] * (abs(row.scale) != 1)
    yield from ["(radial)"] * (row.geometry == "radial")
    yield from (f"{number:.8g}" for number in (*row.invalid, *row.sky_numbers))
    yield from (f"`--{need}`" for need in row.needs)


def test_every_format_is_listed_as_the_table_has_it():
    listed = [each for each in topic("depth").splitlines() if each.startswith("| `")]
    for line, row in zip(listed, ROWS, strict=True):
        place = 0
        for fact in facts(row):
            place = line.find(fact, place)
            assert place >= 0, f"{row.name} lacks {fact}: {line}"
