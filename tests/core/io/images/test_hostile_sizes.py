"""Small files that claim large pictures are refused before they take memory, or take little."""

import tracemalloc
import zipfile

import numpy as np
import pytest
from command_line import color_exr, depth_exr, run, succeed
from image_files import save
from refusals import refuses

from defocus_core.io.array_files import read_entries, read_map
from defocus_core.io.depth_formats import depth
from defocus_core.io.images import describe as describing
from defocus_core.io.read_files import MAX_PIXELS


def claims(file, shape, dtype="<f4"):
    """The header of an NPY file of a shape, without its numbers."""
    header = {"shape": shape, "fortran_order": False, "descr": dtype}
    np.lib.format.write_array_header_1_0(file, header)


def npz_claims(path, shape, *names):
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            with archive.open(f"{name}.npy", "w") as member:
                claims(member, shape)
    return path


@pytest.mark.parametrize("shape", [(60_000, 60_000), (1, 60_000, 60_000), (MAX_PIXELS + 1, 1)])
def test_npy_obeys_the_limit_of_pixels(shape, tmp_path):
    path = tmp_path / "a.npy"
    with path.open("wb") as file:
        claims(file, shape)
    for read in (describing.describe, read_map):
        with refuses("too-large", f"{shape[-1]}×{shape[-2]} px", path=path):
            read(path)


@pytest.mark.parametrize("kind", ["png", "exr", "npz"])
def test_info_decodes_no_more_numbers_than_a_small_file_can_have(kind, tmp_path, monkeypatch):
    """A PNG of 5 MB may have 1.2e9: 40 s; an EXR of 2.5 MB took 5 GB to be called no depth."""
    path = tmp_path / f"a.{kind}"
    {
        "png": lambda: save(path, np.zeros((200, 300, 3), np.uint8)),
        "exr": lambda: color_exr(path, np.zeros((200, 300, 3), np.float32)),
        "npz": lambda: np.savez_compressed(path, depth=np.ones((200, 300)), small=np.ones((2, 2))),
    }[kind]()
    decoded = run("info", path)
    assert "not decoded" not in decoded.out
    monkeypatch.setattr(describing, "MOST_NUMBERS", 10_000)
    ran = succeed("info", path, "--json")
    assert ran.json["files"][0]["depth_note"].startswith("not decoded: 0 million numbers in a file")
    ran = run("depth", path, "-o", tmp_path / "z.exr")
    assert (ran.code, (tmp_path / "z.exr").exists()) == (3, False)
    assert "has 0 million numbers" in ran.err
    monkeypatch.setattr(describing, "NUMBERS_OF_A_BYTE", 10_000)
    assert run("info", path) == decoded


@pytest.mark.parametrize("kind", ["npz", "png", "exr"])
def test_depth_of_another_size_is_refused_before_it_is_read(kind, tmp_path):
    """An NPZ of 20000 x 20000 zeros has 1.5 MB and took 3.4 GB to be refused."""
    path = tmp_path / f"a.{kind}"
    if kind == "npz":
        npz_claims(path, (40, 50), "depth")
    else:
        values = np.random.default_rng(0).integers(1, 9999, (40, 50)).astype("f4")
        if kind == "png":
            save(path, values[..., None].astype(np.uint16))
        else:
            depth_exr(path, values)
        path.write_bytes(path.read_bytes()[:-1500])
    with refuses("damaged", path=path):
        depth.read_depth(path, size=(50, 40))
    with refuses("wrong-size", "50x40 px", "60x40 px", path=path):
        depth.read_depth(path, size=(60, 40))


def test_the_header_of_a_member_is_read_no_longer_than_headers_are(tmp_path):
    """One of 900 MB of blanks, 1 MB compressed, took 1.8 GB."""
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        size = 2**26
        header = np.lib.format.magic(2, 0) + size.to_bytes(4, "little")
        archive.writestr("a.npy", header + b" " * size)
    tracemalloc.start()
    with refuses("damaged", path=path):
        describing.describe(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < size / 8


def test_a_container_of_too_many_arrays_is_refused(tmp_path):
    names = [str(number) for number in range(4097)]
    assert len(read_entries(npz_claims(tmp_path / "a.npz", (2, 2), *names[1:]))) == 4096
    with refuses("too-large", "more than 4096 arrays"):
        describing.describe(npz_claims(tmp_path / "a.npz", (2, 2), *names))
