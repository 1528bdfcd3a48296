"""The help topic on depth lists every format as the table has it."""

from __future__ import annotations

from defocus_cli.commands.help import text
from defocus_core.errors import with_dashes
from defocus_core.io.depth_formats.rules import ANY, FLOATS, SKY
from defocus_core.io.depth_formats.table import ROWS


def number(value):
    return f"{value:.8g}"


def files(row):
    if set(row.files) == set(ANY):
        return "any"
    kinds = list(row.files)
    if set(FLOATS) <= set(kinds):
        kinds = ["floats", *(kind for kind in kinds if kind not in FLOATS)]
    return ", ".join(kinds)


def factor(scale):
    if abs(scale) == 1:
        return "v" if scale > 0 else "-v"
    below = 1 / scale
    return f"v / {number(below)}" if scale < 1 else f"{number(scale)} v"


def rule(row):
    """What the numbers v become."""
    if row.rule == "radius":
        return "px of radius"
    if row.rule == "log":
        return "near^(1−t) far^t"
    v = "float32 of the bytes" if row.bits == "float32" else row.bits or ""
    if row.weights:
        v = " + ".join(
            f"{number(w)} {c}" if w != 1 else c for w, c in zip(row.weights, "RGB", strict=True)
        )
        v = f"({v})"
    scaled = factor(row.scale).replace("v", v, 1) if v else factor(row.scale)
    if "depth-range" in row.needs:
        return "1/z linear in v" if row.rule == "inverse" else "z linear in v"
    if row.rule == "inverse":
        sidecars = ("calib.txt", "dmin.txt", "parameters.cfg", "camera.json")
        shifted = row.name == "disparity" or row.sidecar in sidecars
        scaled = f"({scaled} + doffs)" if shifted else f"({scaled})" if "/" in scaled else scaled
        known = [f"f = {number(row.focal_px)} px"] if row.focal_px else []
        known += [f"b = {number(row.baseline)} m"] if row.baseline else []
        return ", ".join([f"1 / {scaled}" if row.per_metre else f"f b / {scaled}", *known])
    return scaled if row.rule else "depth or disparity"


def marks(row):
    """Which numbers are invalid, and which are sky."""
    invalid = [number(n) for n in row.invalid] + ["inf"] * row.invalid_infinity
    invalid += [f"{row.holes} 0"] * bool(row.holes)
    sky = [f"≥ {number(row.sky)}"] * (row.sky != SKY) + [number(n) for n in row.sky_numbers]
    sky += ["alpha 0"] * row.alpha
    if row.mask is not None:
        (invalid if row.mask.sky is None else sky).append("mask")
    told = [f"invalid {', '.join(invalid)}"] * bool(invalid) + [f"sky {', '.join(sky)}"] * bool(sky)
    return "; ".join(told) or "–"


def needed(row):
    """What must be said, or lie beside the file."""
    told = [f"`--{need}`" for need in row.needs] + ["`--depth-kind`"] * (not row.rule)
    if row.geometry == "ask":
        told.append("`--radial` or `--planar`")
    if row.geometry == "radial" and row.focal_px is None:
        told.append("`--fov`")
    calibrated = row.rule == "inverse" and not row.per_metre and not row.needs
    if row.sidecar in ("text-chunks", "heic", "gdepth"):
        told.append("metadata of the file")
    elif row.sidecar:
        told.append(row.sidecar)
    elif calibrated:
        told += [
            f"`--{n}`" for n, v in (("focal-px", row.focal_px), ("baseline", row.baseline)) if not v
        ]
    return ", ".join(told) or "–"


def line(row):
    names = ", ".join(f"`{name}`" for name in (row.name, *row.aliases))
    geometry = " (radial)" if row.geometry == "radial" else ""
    title = with_dashes(f"{row.title}; {row.note}" if row.note else row.title)
    cells = (names, title, files(row), f"{rule(row)}{geometry}", marks(row), needed(row))
    return f"| {' | '.join(cells)} |"


def test_every_format_is_listed_as_the_table_has_it():
    listed = [each for each in text("depth").splitlines() if each.startswith("| `")]
    missing = [line(row) for row in ROWS if line(row) not in listed]
    assert not missing, "\n".join(["defocus_cli/help/depth.md lacks:", *missing])
    assert listed == [line(row) for row in ROWS]
