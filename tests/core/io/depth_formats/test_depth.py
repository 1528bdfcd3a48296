"""Depth files: which channel, in which unit, where is sky, where is nothing."""

from io import BytesIO

import numpy as np
import pytest
from elements import write
from image_files import box, multi_part, random_planes, save
from refusals import refuses

from defocus_core import UsageProblem, read_color, read_depth
from defocus_core.io.depth_formats.exr_depth_channel import NoDepthChannel

INF = np.float32(np.inf)


def plane(seed=0, shape=(5, 6)):
    return np.random.default_rng(seed).random(shape, np.float32) + 1


def exr(path, *names):
    """An EXR file whose every channel differs."""
    return write(path, {name: plane(seed) for seed, name in enumerate(names)})


OTHERS = "R G B N.X N.Y N.Z P.X P.Y P.Z"


@pytest.mark.parametrize(
    ("names", "depth"),
    [
        ("Z", "Z"),
        ("anything", "anything"),
        ("R G B P.Z", "P.Z"),
        ("L.Depth.Z L.Denoising_Depth.Z L.R L.G L.B", "L.Depth.Z"),
        ("R", "R"),
        ("ViewLayer.Combined.R ViewLayer.Depth.Z ViewLayer.Mist.Z", "ViewLayer.Depth.Z"),
        *(
            (f"{OTHERS} {name}", name.split()[0])
            for name in (
                *("Z", "V", "Pz", "Z.Z", "depth.Z", "depth.v", "Depth", "zdepth", "depth.R"),
                *("VRayZDepth.R", "zDepth.Y", "Zdepth.R", "FinalImagePW_WorldDepth.R"),
                *("depth.R depth.G depth.B", "ViewLayer.Depth.V"),
            )
        ),
    ],
)
def test_the_depth_channel_is_found_by_its_name(tmp_path, names, depth):
    every = [name.replace("Denoising_", "Denoising ") for name in names.split()]
    read = read_depth(exr(tmp_path / "a.exr", *every))
    assert read.channel == depth
    np.testing.assert_array_equal(read.metres, plane(names.split().index(depth)))
    assert read.note == f"EXR float channel {depth}, metres"


def test_a_layer_of_one_channel_is_chosen_by_its_name(tmp_path):
    path = exr(tmp_path / "a.exr", "fog.Y", "far.R", "far.G", "R", "G", "B")
    np.testing.assert_array_equal(read_depth(path, channel="Fog").metres, plane(0))
    with refuses("no-such-channel"):
        read_depth(path, channel="far")


def test_the_likeliest_channel_is_proposed(tmp_path):
    vectors = ("N.X", "N.Y", "N.Z", "Px", "Py", "Pz")
    path = exr(tmp_path / "a.exr", "R", "G", "B", *vectors, "camera_distance.y")
    with refuses("no-depth", "‹depth-channel› Pz", kind=NoDepthChannel):
        read_depth(path)


def test_several_candidates_are_listed_and_chosen(tmp_path):
    path = exr(tmp_path / "a.exr", "Z", "depth.Z", "R")
    with refuses("ambiguous", "Z, depth.Z", "‹depth-channel› Z"):
        read_depth(path)
    for name in ("depth.Z", "DEPTH.z", "0/depth.Z"):
        np.testing.assert_array_equal(read_depth(path, channel=name).metres, plane(1))
    with refuses("no-such-channel", "R, Z, depth.Z", "‹depth-channel›"):
        read_depth(path, channel="W")


def test_names_are_compared_exactly_first(tmp_path):
    path = exr(tmp_path / "a.exr", "a", "A", "b")
    np.testing.assert_array_equal(read_depth(path, channel="A").metres, plane(1))
    np.testing.assert_array_equal(read_depth(path, channel="B").metres, plane(2))


def test_all_parts_are_searched(tmp_path):
    z = plane(7, (24, 32))
    path = multi_part(tmp_path / "a.exr", rgba=random_planes("RGBA"), depth={"Z": z})
    read = read_depth(path)
    np.testing.assert_array_equal(read.metres, z)
    assert read.note == "EXR float channel Z of part depth, metres"
    color = read_color(path)
    assert color.channels == ("R", "G", "B", "A")
    np.testing.assert_array_equal(color.extras["depth.Z"], z)


def test_sky_and_holes(tmp_path):
    values = np.array([[np.inf, 1e10, 9.9e9, 65504, np.nan, 0, -1, -np.inf, 2]], np.float32)
    write(tmp_path / "a.exr", {"Z": values})
    read = read_depth(tmp_path / "a.exr")
    assert np.isposinf(read.metres[0]).tolist() == [True, True] + [False] * 7
    assert read.invalid[0].tolist() == [False] * 4 + [True] * 4 + [False]
    assert read.metres[0, 3] == 65504
    # Sky is said in the file's unit.
    assert np.isposinf(read_depth(tmp_path / "a.exr", unit="mm").metres[0]).sum() == 2


def test_the_largest_half_is_sky_in_half_channels_only(tmp_path):
    write(tmp_path / "a.exr", {"Z": np.array([[65504, 65472, np.inf]], np.float16)})
    read = read_depth(tmp_path / "a.exr")
    assert read.metres.tolist() == [[INF, 65472, INF]]
    assert read.note == "EXR half channel Z, metres, 65504 taken as sky"
    for dtype, metres in ((np.float16, np.inf), (np.float32, 65504)):
        path = save(tmp_path / "a.tif", np.array([[[65504], [65472], [2]]], dtype))
        read = read_depth(path)
        assert read.metres.tolist() == [[metres, 65472, 2]]
        assert ("taken as sky" in read.note) == (dtype is np.float16)
    for order in "<>":
        np.save(tmp_path / "a.npy", np.array([[65504, 65472, np.inf]], f"{order}f2"))
        assert read_depth(tmp_path / "a.npy").metres.tolist() == [[INF, 65472, INF]]


def test_depth_must_cover_the_picture(tmp_path):
    windows = {"dataWindow": box(1, 1, 4, 3), "displayWindow": box(0, 0, 5, 5)}
    write(tmp_path / "a.exr", {"Z": plane(0, (3, 4))}, **windows)
    with refuses("invalid-depth", "in 24 pixels", "4x3 at 1,1"):
        read_depth(tmp_path / "a.exr", invalid="error")
    overscan = plane(0, (8, 9))
    windows = {"dataWindow": box(-1, -2, 7, 5), "displayWindow": box(0, 0, 5, 3)}
    write(tmp_path / "b.exr", {"Z": overscan}, **windows)
    np.testing.assert_array_equal(read_depth(tmp_path / "b.exr").metres, overscan[2:6, 1:7])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b" "])
def test_pfm_rows_run_from_bottom_to_top_and_its_header_ends_with_its_line(order, end, tmp_path):
    values = plane()
    if end != b" ":
        values[-1, 0] = np.frombuffer(b"\n\r A", f"{order}f4")[0]  # may look like an end of a line
    head = b"Pf\n# by hand\n6 5\n%d.0" % {"<": -1, ">": 1}[order] + end
    (tmp_path / "a.pfm").write_bytes(head + values[::-1].astype(f"{order}f4").tobytes())
    read = read_depth(tmp_path / "a.pfm")
    np.testing.assert_array_equal(read.metres, values)
    assert read.metres.dtype == np.dtype("=f4")


@pytest.mark.parametrize("dtype", ["f2", "<f4", ">f4", "f8"])
def test_floats_of_any_kind_are_metres(dtype, tmp_path):
    values = plane().astype(dtype)
    np.save(tmp_path / "a.npy", values)
    np.save(tmp_path / "b.npy", values[:, :, None])
    save(tmp_path / "c.tif", plane().astype(dtype.strip("<>"))[:, :, None])
    for name in ("a.npy", "b.npy", "c.tif"):
        read = read_depth(tmp_path / name)
        np.testing.assert_array_equal(read.metres, values.astype("f4"))
        assert read.metres.dtype == np.dtype("=f4")


def npy_bytes(values):
    file = BytesIO()
    np.save(file, values, allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "code", "fact"),
    [
        ("a.pfm", b"Pf\n6 5\n-1\n" + bytes(121), "damaged", "6×5 px of float32 are 120"),
        ("a.pfm", b"Pf\n6 5\n-1\n" + bytes(119), "damaged", "119 bytes of pixels"),
        ("a.pfm", b"Pf\n6 5\n0\n" + bytes(120), "damaged", "scale 0"),
        ("a.pfm", b"Pf\n6", "damaged", "header"),
        ("a.pfm", b"Pf\n-6 5\n-1\n" + bytes(120), "damaged", "-6×5 px"),
        ("a.pfm", b"Pf\n9999999 9999999\n-1\n", "too-large", "9999999×9999999 px"),
        ("a.pfm", b"PF\n6 5\n-1\n" + bytes(360), "not-one-channel", "PF"),
        ("a.npy", npy_bytes(np.ones((2, 3), np.uint16)), "unknown-unit", "uint16"),
        ("a.npy", npy_bytes(np.ones((2, 3, 3), np.float32)), "wrong-shape", "2 × 3 × 3"),
        ("a.npy", npy_bytes(np.array([{"pickled": 1}], dtype=object)), "not-numbers", ""),
        ("a.npy", npy_bytes(np.ones((50, 60), np.float32))[:-8], "damaged", ""),
    ],
)
def test_a_bad_file_is_refused(tmp_path, name, content, code, fact):
    (tmp_path / name).write_bytes(content)
    with refuses(code, fact, path=tmp_path / name):
        read_depth(tmp_path / name)


def test_whole_numbers_in_exr_have_no_unit_but_the_one_given(tmp_path):
    path = tmp_path / "a.exr"
    write(path, {"Z": np.array([[0, 1000, 70_000]], np.uint32)})
    with refuses("unknown-unit", "‹depth-unit› mm", path=path):
        read_depth(path)
    read = read_depth(path, unit="mm")
    np.testing.assert_array_equal(read.metres, np.array([[0, 1, 70]], "f"))
    assert read.note == "EXR uint32 channel Z, millimetres"


def test_depth_has_one_channel(tmp_path):
    path = save(tmp_path / "a.png", np.full((4, 5, 3), 1000, np.uint16))
    assert (read_depth(path).metres == 1).all(), "equal channels are one"
    path = save(tmp_path / "a.png", np.arange(60).reshape(4, 5, 3).astype(np.uint16))
    with refuses("not-one-channel", "R, G, B", path=path):
        read_depth(path)
    with refuses("idle-option", kind=UsageProblem, field="depth-channel"):
        read_depth(path, channel="R")
