"""``defocus render --stats``: each kind of skip, on a scene where it matters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from command_line import color_exr, depth_exr, ramp, render, texture

from defocus_core.tiling import TILE

W, H = 3 * TILE, TILE


def rendered(
    tmp_path: Path, metres: np.ndarray[Any, Any], *args: str
) -> tuple[dict[str, int], str]:
    color = color_exr(tmp_path / "c.exr", texture(W, H))
    depth = depth_exr(tmp_path / "z.exr", metres)
    ran = render(color, depth, "-o", tmp_path / "out", "--stats", "--json", *args)
    assert ran.code == 0, ran.err
    return ran.json["pictures"][0]["stats"], ran.err


def flat(metres: float) -> np.ndarray[Any, Any]:
    return np.full((H, W), metres, np.float32)


def test_a_frame_in_focus_is_copied(tmp_path: Path) -> None:
    stats, told = rendered(tmp_path, flat(2.0))
    assert stats["pixels_copied"] == stats["pixels"] == W * H
    assert stats["slice_tiles_blurred"] == 0
    assert f"{W * H} of {W * H}  100 %  pixels copied" in told


def test_what_is_in_focus_is_copied_beside_what_is_not(tmp_path: Path) -> None:
    metres = flat(2.0)
    metres[:, -TILE:] = 3.0  # behind, in the last tile, which blurs over its neighbour's border
    stats, told = rendered(tmp_path, metres)
    assert stats["pixels_copied"] == TILE * H
    assert " 33 %  pixels copied" in told


def test_slices_that_do_not_reach_a_tile_are_skipped(tmp_path: Path) -> None:
    stats, told = rendered(tmp_path, ramp(W, H))
    assert 0 < stats["slice_tiles_done"] < 0.4 * stats["slice_tiles"]
    share = round(100 * stats["slice_tiles_done"] / stats["slice_tiles"])
    assert f" {share} %  steps of slice x tile done" in told
    assert stats["slice_tiles_blurred"] < stats["slice_tiles_done"]


def test_nothing_is_invented_behind_tiles_without_an_edge(tmp_path: Path) -> None:
    metres = flat(4.0)
    metres[40:80, 20:60] = 1.5  # a card in the first tile
    stats, told = rendered(tmp_path, metres)
    assert stats["tiles_with_hidden"] < stats["tiles"] == 3
    assert stats["tiles_with_hidden"] > 0
    assert f"{stats['tiles_with_hidden']} of 3" in told
    assert rendered(tmp_path, ramp(W, H), "--overwrite")[0]["tiles_with_hidden"] == 0


def test_maps_alone_skip_everything(tmp_path: Path) -> None:
    stats, told = rendered(tmp_path, ramp(W, H), "--outputs", "coc,disparity")
    assert stats == {}
    assert "nothing was rendered" in told


def test_nobody_is_told_unasked(tmp_path: Path) -> None:
    color, depth = color_exr(tmp_path / "c.exr"), depth_exr(tmp_path / "z.exr")
    assert "slice x tile" not in render(color, depth, "-o", tmp_path / "out").err
