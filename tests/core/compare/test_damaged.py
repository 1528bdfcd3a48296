"""Damaged files: none crashes the comparison, and none is the same unless its pixels are."""

from pathlib import Path

import fuzzing
import numpy as np
import OpenEXR
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import run

from defocus_core.io.read_files import quiet

SEED = 20
DEEP = b"\x02\x08\0\0"  # flags of a deep OpenEXR file


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    return folder, fuzzing.sound_files(folder)


def status(a, b):
    (pair,) = run("compare", a, b, "--json").json["pairs"]
    return pair["status"]


def decoded(path):
    """All images of a file, decoded without the code under test."""
    if path.suffix == ".npy":
        return [np.load(path)]
    if path.read_bytes()[4:8] == DEEP:  # OpenImageIO may crash
        return [np.stack(OpenEXR.File(str(path)).parts[0].channels["Z"].pixels.ravel())]
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    with quiet():
        first = oiio.ImageBuf(str(path), 0, 0, config)
        return [
            np.nan_to_num(oiio.ImageBuf(str(path), k, 0, config).get_pixels(oiio.FLOAT))
            for k in range(first.nsubimages)
        ]


@pytest.mark.parametrize("cases", [200, pytest.param(3000, marks=pytest.mark.bench)])
def test_a_damaged_file_is_the_same_only_if_its_pixels_are(cases, sound, tmp_path):
    folder, files = sound
    passed = 0
    for index in range(cases):
        name, data = fuzzing.case(files, SEED, index)
        bad = tmp_path / f"bad{Path(name).suffix}"
        bad.write_bytes(data)
        if status(folder / name, bad) == "same":
            passed += 1
            old, new = decoded(folder / name), decoded(bad)
            assert len(old) == len(new), (index, name)
            assert all(map(np.array_equal, old, new)), (index, name)
    assert passed < 0.1 * cases


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_a_file_that_was_cut_off_is_unreadable(share, sound, tmp_path):
    folder, files = sound
    for name, data in files.items():
        bad = tmp_path / name
        bad.write_bytes(data[: int(share * len(data))])
        assert status(folder / name, bad) == "unreadable", name


def test_each_sound_file_is_the_same_as_itself(sound):
    folder, files = sound
    for name in files:
        assert status(folder / name, folder / name) == "same", name
