"""Hostile and damaged inputs: refused at once in a line that names them, never copied on."""

import struct
import subprocess
import sys

import h5py
import numpy as np
import OpenEXR
import pytest
from command_line import LENS, failed, photograph, read_exr, run, texture
from deep_files import write_deep_samples
from elements import write
from refusals import refuses

from defocus_core import read_depth

LONG = "9" * 100_000


@pytest.mark.parametrize(
    "words",
    [
        *(("--focus", LONG), ("--fnumber", f"1{LONG}"), ("--outputs", f"{LONG},{LONG}")),
        *(("--depth-scale", f"{LONG}/{LONG}"), ("--frames", "1," * 50_000)),
        ("--threads", "100000"),
    ],
)
def test_a_text_of_any_length_is_refused_at_once(words, color, depth, out):
    ran = run("render", color, depth, "-o", out, *LENS, *words)
    assert ran.code == 2, ran.err
    assert ran.err.count("\n") == 1
    assert len(ran.err) < 1000
    assert "characters" in ran.err or "not in the range" in ran.err


@pytest.mark.parametrize("codec", ["dwaa", "dwaa:500", "input"])
def test_carried_channels_are_bit_equal_in_any_codec(codec, depth, out, tmp_path):
    ids = np.random.default_rng(0).integers(1, 2**30, (16, 24), np.uint32).view(np.float32)
    planes = dict(zip("RGB", np.moveaxis(texture(), 2, 0).astype(np.float16), strict=True))
    planes |= {f"Crypto00.{name}": ids for name in "RGBA"} | {"Z": ids, "N.B": planes["B"]}
    compression = OpenEXR.B44_COMPRESSION if codec == "input" else OpenEXR.ZIP_COMPRESSION
    path = write(tmp_path / "a.exr", planes, compression=compression)
    given = read_exr(path)
    ran = photograph(path, depth, "-o", out, "--compression", codec)
    made = read_exr(out / "render" / "a.exr")
    for name in planes.keys() - set("RGB"):
        assert made[name].tobytes() == given[name].tobytes()
    assert "written with zip" in ran.err


def test_carried_channels_that_are_not_finite_are_said(depth, out, tmp_path):
    planes = {name: texture()[:, :, 0].copy() for name in ("R", "G", "B", "N.X", "Z")}
    planes["N.X"][0, :2], planes["Z"][:] = (np.nan, np.inf), np.inf
    ran = photograph(write(tmp_path / "a.exr", planes), depth, "-o", out)
    assert "N.X, which is copied, is NaN or infinite in 2 pixels" in ran.err
    assert "Z, which" not in ran.err


def external(file, other):
    shape = np.ones((4, 6), "f4").tofile(other) or (4, 6)
    file.create_dataset("depth", shape, "f4", external=[(str(other), 0, 96)])


def virtual(file, other):
    with h5py.File(other, "w") as source:
        source["d"] = np.ones((4, 6), "f4")
    layout = h5py.VirtualLayout((4, 6), "f4")
    layout[:] = h5py.VirtualSource(str(other), "d", (4, 6))
    file.create_virtual_dataset("depth", layout, fillvalue=3)


def unwritten(file, _):
    file.create_dataset("depth", (4, 6), "f4", fillvalue=3)


@pytest.mark.parametrize(
    ("make", "code"),
    [*((external, "unsupported"), (virtual, "unsupported")), (unwritten, "damaged")],
)
def test_hdf5_gives_the_numbers_that_are_in_it_alone(make, code, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        make(file, tmp_path / "other")
    with refuses(code, path=tmp_path / "a.h5"):
        read_depth(tmp_path / "a.h5")


def deep(path, *depths):
    pixel = [{**dict.fromkeys("RGB", 0.1), "A": 0.5, "Z": z} for z in depths]
    return write_deep_samples(path, [[pixel] * 24] * 16)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"screenWindowWidth\0float\0" + struct.pack("<if", 4, 1), struct.pack("<f", -0.25)),
        (b"screenWindowWidth\0float\0" + struct.pack("<if", 4, 1), struct.pack("<f", np.nan)),
        (b"channels\0chlist\0", b"\0"),
        (b"screenWindowCenter\0v2f\0", b"int\0"),
    ],
)
def test_a_damaged_header_of_deep_pixels_is_refused(old, new, out, tmp_path):
    path = deep(tmp_path / "a.exr", 1.0, 2.0)
    data = path.read_bytes()
    at = data.index(old) + len(old) + (4 if b"chlist" in old else -4)
    path.write_bytes(data[:at] + new + data[at + len(new) :])
    for words in (("info", path), ("render", path, "-o", out, *LENS)):
        failed(run(*words), 3, "damaged", path)
    assert not (out / "render").exists()


def test_an_error_that_stderr_cannot_take_is_said_whole_on_stdout(tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (5, 5));"
    command = [sys.executable, "-c", f"{limit} from defocus_cli.__main__ import run; run()"]
    with (tmp_path / "err").open("w") as err:
        ran = subprocess.run(
            [*command, "info", "none.exr"], stdout=subprocess.PIPE, stderr=err, text=True
        )
    assert (ran.returncode, ran.stdout) == (3, "defocus: none.exr: no such file; check the name\n")
