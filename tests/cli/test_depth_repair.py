"""The repair of depth: how a user steers it, and where it is recorded and drawn."""

import numpy as np
import pytest
from command_line import color_exr, depth_exr, header, read_exr, run, succeed

WIDTH, HEIGHT = 144, 96
LENS = ("--focal-length", "100mm", "--fnumber", "2", "--focus", "2m", "--sensor-width", "4mm")
NEAR, FAR = 2.0, 10.0  # m


def two_surfaces(folder, width):
    """A bright surface before a dark one, whose edge in disparity is a ramp of so many px."""
    x = np.arange(WIDTH) + 0.5 - WIDTH / 2
    share = np.tile(np.clip(x / width + 0.5, 0, 1), (HEIGHT, 1))
    metres = (1 / (1 / NEAR + share * (1 / FAR - 1 / NEAR))).astype(np.float32)
    color = np.where(x < 0, 0.8, 0.1)[None, :, None] * np.ones((HEIGHT, 1, 3))
    depth = depth_exr(folder / f"depth{width:g}.exr", metres)
    return color_exr(folder / "rgb.exr", color.astype(np.float32)), depth


def rendered(out, *args):
    ran = succeed("render", *args, *LENS, "-o", out, "--json", "--exr-type", "float")
    return read_exr(out / "render" / "rgb.exr")["G"], ran.json["pictures"][0]


def test_the_record_stands_in_words_json_journal_and_header(tmp_path):
    files, out = two_surfaces(tmp_path, 8), tmp_path / "out"
    args = (*files, *LENS, "-o", out, "--outputs", "render,coc")
    planned = run("render", *args, "--dry-run", "--json").json["pictures"][0]
    ran = run("render", *args, "-v", "--json")
    record = ran.json["pictures"][0]["depth_repair"]
    assert record["kinds"] == ["soft-edges", "displaced-edges"]
    assert record["edge_width_px"] == pytest.approx(8, abs=0.5)
    assert record["share"] == pytest.approx(7 / WIDTH, abs=0.02)
    assert planned["forecast"]["depth_repair"] == record
    assert '"depth_repair":{"kinds":["soft-edges"' in (out / "journal.jsonl").read_text()
    text = header(out / "render" / "rgb.exr")["defocus:depth_repair"]
    assert text.startswith("repaired soft-edges, displaced-edges: edge_width_px=8")
    assert text.endswith(f"share={record['share']:g}")
    assert text in ran.err
    assert "defocus:depth_repair" not in header(out / "coc" / "rgb.exr")
    again = run("render", *args, "--json").json["pictures"][0]
    assert again["done_before"]
    assert again["depth_repair"] == record


def test_a_header_says_what_was_asked_and_nothing_of_clean_depth(tmp_path):
    files = two_surfaces(tmp_path, 1)
    said = ("--depth-repair", "auto", "--edge-width", "6px")
    for name, args, asked in (("clean", (), None), ("said", said, "--edge-width 6px")):
        rendered(tmp_path / name, *files, *args)
        attributes = header(tmp_path / name / "render" / "rgb.exr")
        assert attributes.get("defocus:depth_repair_asked") == asked
        assert ("defocus:depth_repair" in attributes) is (asked is not None)
