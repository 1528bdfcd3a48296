"""The report of ``defocus info`` in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from defocus_cli.formats.kinds import KINDS
from defocus_cli.jobs.job import lens_record_words
from defocus_cli.reports.inspection import range_key
from defocus_cli.system.console import counted


def lines(record: Mapping[str, Any]) -> Iterator[str]:
    """What is in a file, from the record that ``inspect`` makes of it."""
    color, depth = record["color"], record["depth"]
    yield "{}: {}x{}".format(record["file"], *record["size"])
    for part in record["parts"]:
        name = f" ({part['name']})" if part["name"] else ""
        named = f"part {part['index']}{name}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part["channels"].items())
        deep = ", deep" if part["deep"] else ""
        yield f"  {named if len(record['parts']) > 1 else ''}{channels}{deep}"
    for shown in record["maps"]:
        kind, ends = KINDS[shown["kind"]], shown[range_key(shown["kind"])]
        reach = f"{ends[0]:.2f} to {ends[1]:.2f} {kind.unit}".rstrip() if ends else ""
        yield f"  {kind.title}: {reach or 'no finite pixel'}"
    if record["maps"] and color is None and depth is None:
        return
    if color is None:
        yield f"  no colour: {record['color_note']}"
    else:
        bad = color["nonfinite_pixels"]
        holes = f", {counted(bad, 'pixel')} not finite" if bad else ""
        yield f"  colour: {', '.join(color['channels'])}{holes} ({record['color_note']})"
    if depth is None:
        yield f"  no depth: {record['depth_note']}"
    else:
        yield from _depth_lines(depth, record["depth_note"])
    for sentence in record["evidence"]:
        yield f"  {sentence}"


def pair_lines(pair: Mapping[str, Any]) -> Iterator[str]:
    """What is wrong between colour and depth, from a record of ``inspect_pairs``."""
    if not pair["evidence"] and "preview" not in pair:
        return
    yield " and ".join(dict.fromkeys((pair["color"], pair["depth"]))) + ":"
    for sentence in pair["evidence"]:
        yield f"  {sentence}"
    if "preview" in pair:
        yield f"  repair of the depth: {pair['repair'] or 'none'} -> {pair['preview']}"


def _depth_lines(depth: Mapping[str, Any], note: str) -> Iterator[str]:
    """The depth of a file in words."""
    ends = depth["range_m"]
    reach = f"{ends[0]:.6g} m to {ends[1]:.6g} m" if ends else "no finite depth"
    invalid = counted(depth["invalid_pixels"], "invalid pixel")
    yield f"  depth: {reach}, {depth['sky_pixels']} sky and {invalid} ({note})"
    if depth["coc_px"] is not None:
        near, far = depth["coc_px"]
        yield f"  CoC: {near:.2f} to {far:.2f} px ({lens_record_words(depth['lens'])})"
        if depth["repair"]:
            yield f"  rendered: {depth['repair']}"
    for warning in depth["warnings"]:
        yield f"  warning: {warning}"
