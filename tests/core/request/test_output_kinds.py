"""Each row of the table of kinds is all that the command line needs to write and explain it."""

import json
import re

import numpy as np
import pytest
from command_line import header, pair, photograph, read_exr, run, topic

from defocus_core.io.depth_formats.exr_depth_channel import NO_DEPTH
from defocus_core.request.output_kinds import KINDS

MAPS = [kind for kind in KINDS.values() if not kind.image]


def name_of(kind):
    return kind.name


@pytest.mark.parametrize("kind", KINDS.values(), ids=name_of)
def test_a_kind_is_written_alone_with_its_name_and_info_tells_what_a_map_shows(kind, tmp_path):
    photograph(*pair(tmp_path), "-o", tmp_path / "out", "--outputs", kind.name, "--preview")
    file = tmp_path / "out" / kind.name / "a.exr"
    assert header(file)["defocus:kind"] == kind.name
    channels = read_exr(file)
    views = ["", *(f"{view}." for view in kind.views[1:])]  # the default view has no name
    colors = {f"{view}{name}" for view in views for name in "RGB"}
    assert set(channels) == (colors if kind.image else {kind.channel or kind.name})
    assert {pixels.dtype for pixels in channels.values()} == {
        np.dtype(np.float16 if kind.image else np.float32)
    }
    assert file.with_suffix(".preview.png").exists()
    if kind.image or kind.source:  # told as what they are of
        return
    values = channels[kind.channel or kind.name]
    minimum, maximum = float(values.min()), float(values.max())
    reach = f"{minimum:.2f} to {maximum:.2f} {kind.unit}".rstrip()
    assert f"  {kind.title}: {reach}\n" in run("info", file).out
    shown = json.loads(run("info", file, "--json").out)["files"][0]["maps"][0]
    assert shown["kind"] == kind.name
    assert shown[f"range_{kind.unit}" if kind.unit else "range"] == [minimum, maximum]


def test_help_has_a_line_for_each_kind():
    shown = run("render", "--help").out
    assert all(f"    {kind.name:<13} {kind.help}\n" in shown for kind in KINDS.values())
    assert f"maps ({', '.join(kind.name for kind in MAPS)})" in " ".join(shown.split())


def test_the_topic_on_conventions_lists_each_kind():
    table = topic("conventions").partition("| kind | picture | file |")[2].partition("\n\n")[0]
    listed = re.findall("`(\\w+)`", " ".join(row.split("|")[0] for row in table.split("\n|")[1:]))
    assert listed == list(KINDS)


def test_maps_but_that_of_depth_are_no_depth():
    maps = {kind.name for kind in KINDS.values() if not kind.image}
    assert maps - {"depth"} == {*NO_DEPTH}
