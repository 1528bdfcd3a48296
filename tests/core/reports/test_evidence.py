"""``defocus info`` names formats that the evidence fits."""

import numpy as np
from command_line import ramp, run, succeed, write_exr
from depth_files import gdepth, npy, png
from elements import write
from optional_libraries import HEIC_MAGIC, heic, write_hdf5


def evidence(path, *args):
    ran = succeed("info", "--json", path, *args)
    (record,) = ran.json["files"]
    told: list[str] = record["evidence"]
    shown = run("info", path, *args).out
    assert all(f"  {each}" in shown for each in told)
    return "\n".join(told)


def test_plain_depth_has_none(tmp_path):
    assert evidence(write_exr(tmp_path / "a.exr", Z=ramp())) == ""
    assert evidence(npy(tmp_path / "a.npy", ramp())) == ""


def test_channels_of_unreal(tmp_path):
    planes = {"FinalImageMovieRenderQueue_WorldDepth.R": ramp() * 100}
    header_free = write_exr(tmp_path / "a.exr", **{"R": ramp(), "G": ramp(), "B": ramp() + 1})
    assert evidence(header_free) == ""
    told = evidence(write(tmp_path / "u.exr", planes))
    assert "unreal-mrq; give --depth-format unreal-mrq" in told


def test_arrays_to_choose_from_are_named_and_their_format(tmp_path):
    arrays = {"depths": np.ones((2, 8, 6), "f4"), "rawDepths": np.ones((2, 8, 6), "f4")}
    path = write_hdf5(tmp_path / "nyu.mat", arrays)
    assert "nyu-mat; give --depth-format nyu-mat" in evidence(path)
    assert "no depth: holds the arrays depths, rawDepths; choose one" in run("info", path).out


def test_gdepth_in_a_photograph(tmp_path):
    image = png(tmp_path / "d.png", ramp() * 50, np.uint8).read_bytes()
    path = gdepth(tmp_path / "a.jpg", image, Format="RangeLinear", Near=1, Far=5, Units="m")
    told = "GDepth in its XMP: android-gdepth; give --depth-format android-gdepth"
    assert evidence(path) == told
    assert "depth: 1.78431 m to" in run("info", path, "--depth-format", "android-gdepth").out


def test_the_depth_image_of_a_heic_file(tmp_path):
    path = tmp_path / "a.heic"
    path.write_bytes(HEIC_MAGIC)
    with heic(np.array([[0, 255]], np.uint8), d_min=0.1, d_max=2.0):
        assert "give --depth-format apple-heic" in evidence(path)
        assert run("depth", path, "-o", tmp_path / "z.exr").code == 0
        told = run("info", path, "--depth-format", "apple-heic").out
    assert "depth: 0.5 m to 10 m" in told
