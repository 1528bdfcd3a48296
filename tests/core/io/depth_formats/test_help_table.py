"""The help topic on depth lists every format as the table has it."""

from defocus_cli.commands.help import text
from defocus_core.errors import with_dashes
from defocus_core.io.depth_formats.table import ANY, FLOATS, ROWS, SKY


def number(value):
    return f"{value:.8g}"


def facts(row):
    """What the line of a format must say, in this order."""
    yield ", ".join(f"`{name}`" for name in (row.name, *row.aliases))
    yield with_dashes(f"{row.title}; {row.note}" if row.note else row.title)
    kinds = [kind for kind in row.files if kind not in FLOATS or not set(FLOATS) <= set(row.files)]
    floats = ["floats"] * (len(kinds) < len(row.files))
    yield "any" if set(row.files) == set(ANY) else ", ".join([*floats, *kinds])
    yield {"scale": "", "inverse": "/", "per-metre": "/", "radius": "px of radius"}.get(
        row.rule, "depth or"
    )
    yield row.bits
    yield from (
        f"{number(weight)} {c}"
        for weight, c in zip(row.weights[1:], "GB", strict=False)
        if weight != 1
    )
    if abs(row.scale) != 1:
        yield number(row.scale if row.scale > 1 else 1 / row.scale)
    yield from ["(radial)"] * (row.geometry == "radial")
    invalid = [number(n) for n in row.invalid]
    mask = ["mask"] * (row.mask is not None)
    invalid += [f"{row.holes} 0"] * bool(row.holes) + mask
    yield f"invalid {', '.join(invalid)}" if invalid else ""
    sky = [f"≥ {number(row.sky)}"] * (row.sky != SKY) + [number(n) for n in row.sky_numbers]
    sky += ["alpha 0"] * row.alpha
    yield f"sky {', '.join(sky)}" if sky else ""
    yield from (f"`--{need}`" for need in row.needs)
    yield from ["`--depth-kind`"] * (not row.rule)
    yield {"ask": "`--radial` or `--planar`"}.get(row.geometry, "")
    yield from ["`--fov`"] * (row.geometry == "radial" and row.focal_px is None)
    yield ("metadata of the file" if row.sidecar in ("heic", "gdepth") else row.sidecar)


def test_every_format_is_listed_as_the_table_has_it():
    listed = [each for each in text("depth").splitlines() if each.startswith("| `")]
    for line, row in zip(listed, ROWS, strict=True):
        place = 0
        for fact in facts(row):
            place = line.find(fact, place)
            assert place >= 0, f"{row.name} lacks {fact}: {line}"
