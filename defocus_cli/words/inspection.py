"""The report of ``defocus info`` in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.batch.lenses.lens import lens_record_words
from defocus_core.io.exr.windows import Window
from defocus_core.reports.inspection.inspection import range_key
from defocus_core.reports.inspection.shot_summary import range_words
from defocus_core.system.text import counted


def lines(record: Mapping[str, Any]) -> Iterator[str]:
    """What is in a file, from the record that ``inspect`` makes of it."""
    color, depth = record["color"], record["depth"]
    yield "{}: {}x{}".format(record["file"], *record["size"])
    for part in record["parts"]:
        name = f" ({part['name']})" if part["name"] else ""
        named = f"part {part['index']}{name}: "
        channels = ", ".join(f"{name} {kind}" for name, kind in part["channels"].items())
        deep = ", deep" if part["deep"] else ""
        yield f"  {named if len(record['parts']) > 1 else ''}{channels}{deep}{_layout(part)}"
        if "samples" in part:
            yield f"    {_samples(part['samples'])}"
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
        if color.get("nothing_pixels") or color.get("partial_pixels"):
            partial = f"below 1 in {counted(color['partial_pixels'], 'pixel')}"
            holes += f", alpha 0 in {counted(color['nothing_pixels'], 'pixel')} and {partial}"
        yield f"  colour: {', '.join(color['channels'])}{holes} ({record['color_note']})"
    if depth is None:
        yield f"  no depth: {record['depth_note']}"
    else:
        yield from _depth_lines(depth, record["depth_note"])
    for sentence in record["evidence"]:
        yield f"  {sentence}"


def _samples(samples: Mapping[str, Any]) -> str:
    """The samples of a deep part in words."""
    ends = samples["range_z"]
    depths = f", Z {ends[0]:.6g} to {ends[1]:.6g}" if ends else ", without Z"
    return (
        f"{counted(samples['total'], 'sample')} in {counted(samples['pixels'], 'pixel')}, "
        f"{counted(samples['most_of_a_pixel'], 'sample')} a pixel at most{depths}"
    )


def _layout(part: Mapping[str, Any]) -> str:
    """Views, windows and pixels of a part of an EXR, as far as they are not the usual ones."""
    words = []
    if part["views"]:
        words.append(f"view{'s' * (len(part['views']) > 1)} {', '.join(part['views'])}")
    windows = [part.get(f"{name}_window") for name in ("data", "display")]
    if windows[0] != windows[1]:
        data, display = (Window(*window) for window in windows if window)
        words.append(f"data window {data}, display window {display}")
    if part.get("pixel_aspect", 1) != 1:
        words.append(f"pixels {part['pixel_aspect']:g} times as wide as high")
    return "".join(f"; {word}" for word in words)


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
    invalid = counted(depth["invalid_pixels"], "invalid pixel")
    nothing = f", nothing in {counted(depth['nothing_pixels'], 'pixel')}"
    absent = nothing if depth["nothing_pixels"] else ""
    reach = range_words(depth)
    yield f"  depth: {reach}, {depth['sky_pixels']} sky and {invalid}{absent} ({note})"
    if depth["coc_px"] is not None:
        near, far = depth["coc_px"]
        yield f"  CoC: {near:.2f} to {far:.2f} px ({lens_record_words(depth['lens'])})"
        if depth["repair"]:
            yield f"  rendered: {depth['repair']}"
    for warning in depth["warnings"]:
        yield f"  warning: {warning}"
