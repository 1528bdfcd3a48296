"""Small files that claim large pictures are refused before they take memory, or take little."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import pair, render, run, texture
from image_files import save
from refusals import refuses

from defocus_core.io import arrays
from defocus_core.io.array_files.float_maps import read_float_map
from defocus_core.io.images.color import read_color
from defocus_core.io.images.describe import describe
from defocus_core.io.safe_files import MAX_PIXELS
from defocus_core.reports.inspection import inspection


def sparse_npy(path: Path, shape: tuple[int, ...]) -> Path:
    """An NPY file that takes a few KB of the disk, whatever its header says."""
    with path.open("wb") as file:
        header = {"shape": shape, "fortran_order": False, "descr": "<f4"}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 4 * int(np.prod(shape)))
    return path


@pytest.mark.parametrize("shape", [(60_000, 60_000), (1, 60_000, 60_000), (MAX_PIXELS + 1, 1)])
def test_npy_obeys_the_limit_of_pixels(shape: tuple[int, ...], tmp_path: Path) -> None:
    path = sparse_npy(tmp_path / "a.npy", shape)
    for read in (describe, read_float_map):
        with refuses("too-large", f"{shape[-1]}×{shape[-2]} px", path=path):
            read(path)


def test_info_reads_a_large_file_into_scratch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A PNG of 236 kB may have 81 million pixels, which took 1 GB; now it takes 100 MB."""
    color, depth = pair(tmp_path)
    render(color, depth, "-o", tmp_path / "out", "--outputs", "coc,trust")
    png = save(tmp_path / "a.png", (65535 * texture()).astype(np.uint16))
    grey = save(tmp_path / "grey.png", (65535 * texture()[..., :1]).astype(np.uint16))
    maps = sorted((tmp_path / "out").rglob("*.exr"))
    files: tuple[Any, ...] = (color, depth, png, grey, *maps)
    in_memory = run("info", *files)
    assert in_memory.code == 0
    made = []
    new = arrays.Scratch.__init__

    def counted(scratch: arrays.Scratch, shape: tuple[int, int], dtype: Any) -> None:
        made.append(shape)
        new(scratch, shape, dtype)

    monkeypatch.setattr(arrays.Scratch, "__init__", counted)
    monkeypatch.setattr(inspection, "_NUMBERS_IN_MEMORY", 100)
    assert run("info", *files) == in_memory
    assert len(made) >= len(files)
    assert read_color(png).pixels.shape == texture().shape


def test_info_decodes_no_more_at_once_than_it_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The decoder holds all of an interlaced PNG: 8 GB of a file of 1 MB."""
    path = save(tmp_path / "a.jpg", (255 * texture()).astype(np.uint8))
    monkeypatch.setattr(inspection, "_MAX_AT_ONCE", 0.001)
    ran = run("info", path)
    assert ran.code == 0
    assert "no colour: takes 0 MB to decode; save it as EXR, or not interlaced" in ran.out


def test_info_decodes_no_array_larger_than_it_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor to look for evidence of its format: 3 GB of a file of 3 MB."""
    np.savez_compressed(tmp_path / "a.npz", depth=np.zeros((40, 50)))
    monkeypatch.setattr(inspection, "_MAX_AT_ONCE", 0.001)
    monkeypatch.setattr(np.lib.format, "read_array", None)
    ran = run("info", tmp_path / "a.npz")
    assert ran.code == 0
    assert "no depth: takes 0 MB to decode" in ran.out
