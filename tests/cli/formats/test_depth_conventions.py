"""Each row of the table of depth conventions decodes files as it says, by name or by custom."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run
from image_files import save

from defocus_cli.formats.depth import read_depth
from defocus_cli.formats.depth_conventions import CONVENTIONS, DepthConvention, custom

VALUES = np.array([[1, 7, 250]], np.float32)


def name_of(convention: DepthConvention) -> str:
    return convention.name


@pytest.mark.parametrize("convention", CONVENTIONS.values(), ids=name_of)
def test_a_named_convention_decodes_integers_and_floats(
    convention: DepthConvention, tmp_path: Path
) -> None:
    for dtype in (np.uint16, np.float32):
        np.save(tmp_path / "a.npy", VALUES.astype(dtype))
        read = read_depth(tmp_path / "a.npy", unit=convention.name)
        np.testing.assert_allclose(read.metres, VALUES * convention.scale, rtol=1e-6)
        assert read.note == f"NPY, {convention.words}"


@pytest.mark.parametrize("convention", CONVENTIONS.values(), ids=name_of)
def test_sky_starts_at_the_number_of_the_file_that_its_row_says(
    convention: DepthConvention, tmp_path: Path
) -> None:
    sky = np.float32(convention.sky)
    np.save(tmp_path / "a.npy", np.array([[np.nextafter(sky, np.float32(0)), sky]]))
    metres = read_depth(tmp_path / "a.npy", unit=convention.name).metres
    np.testing.assert_array_equal(np.isposinf(metres), [[False, True]])


def test_the_command_line_offers_every_convention() -> None:
    offered = ", ".join(f"'{name}'" for name in CONVENTIONS)
    assert f"'mile' is not one of {offered}" in run("render", "--depth-unit", "mile").err


@pytest.mark.parametrize(
    ("name", "dtype", "wanted"),
    [
        ("a.png", np.uint16, "mm"),
        ("a.tif", np.uint16, "mm"),
        ("a.tif", np.float32, "m"),
    ],
)
def test_a_file_type_follows_its_custom(
    name: str, dtype: type, wanted: str, tmp_path: Path
) -> None:
    path = save(tmp_path / name, VALUES.astype(dtype)[:, :, None])
    np.testing.assert_allclose(
        read_depth(path).metres, VALUES * CONVENTIONS[wanted].scale, rtol=1e-6
    )


def test_a_file_type_has_one_custom_at_most() -> None:
    customs = [samples for row in CONVENTIONS.values() for samples in row.custom_of]
    assert len(customs) == len(set(customs))
    assert custom("EXR", integers=True) is custom("NPY", integers=True) is None
