"""Colour that is blurred already, and depth that lies elsewhere, are told; others are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run, write_exr
from image_files import save

from defocus_core.batch.jobs.job import Reading
from defocus_core.reports.inspection.evidence import evidence_of_pair

FEW, MANY = (14, 40, 0.4), (60, 24, 0.1)  # squares, their side in px, contrast of their checks
ROWS, COLUMNS = np.mgrid[:240, :320]


def cards(count: int, side: int, checks: float) -> tuple[Any, Any]:
    """Checked squares at 1 to 4 m before a checked wall at 9 m; contrast of the checks."""
    numbers = np.random.default_rng(3)
    metres = np.full((240, 320), 9.0)
    color = 0.3 + checks * ((ROWS // 20 + COLUMNS // 23) % 2)
    for y, x in zip(*numbers.integers(0, ((240 - side,), (320 - side,)), (2, count)), strict=True):
        z, grey = numbers.uniform(1, 4), numbers.uniform(0, 0.9)
        card = np.s_[y : y + side, x : x + side]
        metres[card] = z
        color[card] = grey + checks * ((ROWS[card] // 13 + COLUMNS[card] // 13) % 2)
    return color.astype(np.float32), metres.astype(np.float32)


def blurred(image: Any, times: int) -> Any:
    for _ in range(times):
        padded = np.pad(image, 1, mode="edge")
        image = sum(padded[y : y + 240, x : x + 320] for y in range(3) for x in range(3)) / 9
    return image


def evidence(folder: Path, color: Any, metres: Any) -> tuple[str, ...]:
    grey = np.float32(color)
    pair = (
        write_exr(folder / "c.exr", R=grey, G=grey, B=grey),
        write_exr(folder / "z.exr", Z=metres),
    )
    return evidence_of_pair(*pair, Reading())


def test_a_sharp_picture_on_its_depth_is_not_doubted(tmp_path: Path) -> None:
    assert not evidence(tmp_path, *cards(*FEW))
    assert not evidence(tmp_path, *cards(*MANY))


def test_a_picture_that_is_blurred_far_away_is_told(tmp_path: Path) -> None:
    color, metres = cards(*FEW)
    (line,) = evidence(tmp_path, np.where(metres > 5, blurred(color, 12), color), metres)
    assert "the colour looks blurred already" in line
    assert "at 9 m" in line


def test_a_picture_that_is_blurred_everywhere_is_told(tmp_path: Path) -> None:
    color, metres = cards(*FEW)
    (line,) = evidence(tmp_path, blurred(color, 8), metres)
    assert "the colour looks blurred everywhere" in line


def test_depth_that_lies_beside_the_colour_is_told_with_its_shift(tmp_path: Path) -> None:
    color, metres = cards(*MANY)
    (line,) = evidence(tmp_path, color, np.roll(metres, (5, -7), (0, 1)))
    assert "do not lie on each other" in line
    assert "+7 px to the right and -5 px down" in line


@pytest.mark.parametrize(("axis", "words"), [(0, "upside down"), (1, "mirrored left to right")])
def test_depth_that_is_mirrored_is_told(axis: int, words: str, tmp_path: Path) -> None:
    color, metres = cards(*MANY)
    (line,) = evidence(tmp_path, color, np.flip(metres, axis).copy())
    assert words in line


def test_noise_and_walls_without_edges_are_not_doubted(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).random((240, 320))
    assert not evidence(tmp_path, noise, np.float32(cards(*MANY)[1]))
    flat = np.full((240, 320), 0.5)
    assert not evidence(tmp_path, flat, np.full((240, 320), 3, np.float32))


def test_info_compares_a_colour_and_a_depth_file(tmp_path: Path) -> None:
    color, metres = cards(*MANY)
    grey = dict.fromkeys("RGB", color)
    image, depth = (
        write_exr(tmp_path / "c.exr", **grey),
        write_exr(tmp_path / "z.exr", Z=metres[::-1].copy()),
    )
    (pair,) = run("info", image, depth, "--json").json["pairs"]
    assert (pair["color"], pair["depth"]) == (str(image), str(depth))
    assert "upside down" in pair["evidence"][0]
    assert f"{image} and {depth}:\n  {pair['evidence'][0]}" in run("info", image, depth).out
    both = write_exr(tmp_path / "both.exr", **grey, Z=metres)
    assert run("info", both, "--json").json["pairs"] == [
        {"color": str(both), "depth": str(both), "evidence": []}
    ]
    assert run("info", image, depth, both, "--json").json["pairs"] == []


def test_a_photograph_as_depth_is_no_picture_of_its_own(tmp_path: Path) -> None:
    share = np.repeat(blurred(cards(*FEW)[0], 8)[:, :, None], 3, axis=2)
    path = save(tmp_path / "disparity.jpg", (255 * share).astype(np.uint8))
    said = ("--depth-kind", "disparity", "--depth-range", "1m", "9m", "--json")
    (record,) = run("info", path, *said).json["files"]
    assert record["color"]
    assert record["depth"]
    assert not [line for line in record["evidence"] if "say --depth-range" in line]
    assert run("info", path, *said).json["pairs"] == []
    assert run("info", path, path, *said).json["pairs"][0]["depth"] == str(path)
