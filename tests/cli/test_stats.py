"""The counts of ``--json``: each kind of skip, on a scene where it matters."""

import numpy as np
from command_line import color_exr, depth_exr, photograph, ramp, texture
from renderers import TILE

W, H = 3 * TILE, TILE


def rendered(tmp_path, metres, *args, pixels=None):
    color = color_exr(tmp_path / "c.exr", texture(W, H) if pixels is None else pixels)
    depth = depth_exr(tmp_path / "z.exr", metres)
    ran = photograph(color, depth, "-o", tmp_path / "out", "--json", "--overwrite", *args)
    return ran.json["pictures"][0]["stats"]


def test_pixels_of_left_and_right_that_were_negative_are_counted(tmp_path):
    args = ("--outputs", "render,left,right")
    stats = rendered(tmp_path, ramp(W, H), *args)
    assert stats["pixels_clamped"] < 0.01 * W * H
    dots = (texture(W, H) > 0.95).astype(np.float32)
    stats = rendered(tmp_path, ramp(W, H), *args, pixels=dots)
    share = round(100 * stats["pixels_clamped"] / (W * H))
    assert 2 < share < 90
    said = (tmp_path / "out" / "journal.jsonl").read_text()
    assert f"left, right: below 0, and set to 0, in {share} % of the pixels" in said
    stats = rendered(tmp_path, ramp(W, H), pixels=dots)
    assert "pixels_clamped" not in stats, "there are no halves"


def test_maps_alone_skip_everything(tmp_path):
    stats = rendered(tmp_path, ramp(W, H), "--outputs", "coc,disparity")
    assert stats == {}
