"""Files as other programs write them: what their headers, names and sizes say is heeded."""

import json
import struct

import numpy as np
import pytest
from command_line import (
    LENS,
    header,
    photograph,
    read_exr,
    refused,
    render,
    run,
    succeed,
    write_exr,
)
from elements import write
from image_files import multi_part, random_planes, save
from jobs_files import FIXED, jobs
from refusals import refuses

from defocus_core import InputError, read_color, read_depth, write_image
from defocus_core.io.picture_files import BYTES
from defocus_core.request.job_options import READING_OPTIONS

RAMP = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
BUFFER = {"kind": "disparity", "range_mm": (100_000.0, 100.0)}


@pytest.mark.parametrize(
    ("numbers", "sky", "said", "expected"),
    [
        (RAMP, 1.0, BUFFER, RAMP == 1),
        (RAMP, 0.0, {"kind": "disparity", "range_mm": (100.0, 100_000.0)}, RAMP == 0),
        (RAMP, 0.1, {"kind": "depth", "range_mm": (20_000.0, 2_000.0)}, RAMP <= 0.1),
        (RAMP, 0.9, {"kind": "depth", "range_mm": (2_000.0, 20_000.0)}, RAMP >= 0.9),
        (-RAMP - 1, -1.5, {"scale": -1.0}, RAMP >= 0.5),
    ],
)
def test_sky_is_the_far_end_wherever_that_is(numbers, sky, said, expected, tmp_path):
    np.save(tmp_path / "a.npy", numbers.astype("f4"))
    depth = read_depth(tmp_path / "a.npy", sky=sky, **said)
    np.testing.assert_array_equal(np.isinf(depth.metres), expected)
    assert not depth.warnings
    none = read_depth(tmp_path / "a.npy", sky=sky * 0 + (-9 if expected[0, 0] else 9), **said)
    assert np.isinf(none.metres).sum() in (0, none.metres.size)


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.tif", "a.npy"])
def test_the_bytes_of_a_file_are_read_as_the_file_is(name, tmp_path):
    path = tmp_path / name
    if name == "a.npy":
        np.save(path, RAMP + 1)
        read, values = read_depth, lambda found: found.metres
    else:
        write_image(path, np.stack([RAMP] * 3, axis=2))
        read, values = read_color, lambda found: found.pixels
    whole = path.read_bytes()
    np.testing.assert_array_equal(values(read(whole)), values(read(path)))
    with pytest.raises(InputError) as caught:
        read(whole[: len(whole) // 2])
    assert caught.value.path == BYTES


# A value of each option of reading; those that only ask for what is there anyway are left out.
_SAID = {
    "depth-format": "metres",
    "depth-unit": "cm",
    "depth-scale": "2",
    "depth-kind": "disparity",
    "depth-range": "1m 9m",
    "focal-px": "30",
    "baseline": "65mm",
    "doffs": "1",
    "radial": "",
    "invert": "",
    "fov": "60deg",
    "sky": "1e6",
    "invalid": "fill",
    "invalid-value": "7",
    "resize-depth": "guided",
    "depth-repair": "off",
    "edge-width": "3px",
    "depth-channel": "Q",
    "color-layer": "beauty",
    "blur-channels": "N",
    "part": "3",
    "view": "left",
}
_DEFAULTS = {"depth-format", "depth-repair"}  # of depth in metres that needs no repair


def test_an_option_of_reading_changes_the_picture_or_is_said_to_change_nothing(color, depth, out):
    assert _SAID.keys() == READING_OPTIONS.keys() - {"planar"}
    photograph(color, depth, "-o", out)
    usual = read_exr(out / "render" / "color.exr")["R"]
    for number, (name, value) in enumerate(_SAID.items()):
        own = out.parent / str(number)
        ran = run("render", *LENS, color, depth, "-o", own, f"--{name}", *value.split())
        if ran.code:
            assert f"--{name}" in ran.err or value in ran.err, (name, ran.err)
        elif f"--{name}" not in ran.err and name not in _DEFAULTS:
            assert (read_exr(own / "render" / "color.exr")["R"] != usual).any(), name


def test_an_option_of_reading_is_a_key_of_jobs_files(tmp_path):
    contradict = {"edge-width", "invert"}  # depth-repair off, and a depth that is not relative
    said = {name: _SAID[name] for name in _SAID.keys() - contradict}
    values = {n: text.split() if " " in text else text or True for n, text in said.items()}
    keys = "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())
    (job,) = jobs(tmp_path, f"{FIXED}[reading]\n{keys}")
    for name, value in said.items():
        row = READING_OPTIONS[name]
        assert getattr(job.reading, row.field) == row.parse(value), name


def test_a_focal_length_is_in_pixels_of_the_depth_file(color, tmp_path):
    wall, focal = np.full((8, 12), 3.0), 10.0
    y, x = np.mgrid[:8, :12] - np.array([3.5, 5.5])[:, None, None]
    np.save(tmp_path / "r.npy", (wall * np.sqrt(x**2 + y**2 + focal**2) / focal).astype("f4"))
    np.save(tmp_path / "d.npy", (focal * 0.1 / wall).astype("f4"))
    how = ("--focal-px", "10", "--resize-depth", "nearest", "--outputs", "depth")
    for name, more in (
        ("r.npy", ("--radial",)),
        ("d.npy", ("--depth-kind", "disparity", "--baseline", "100mm")),
    ):
        photograph(color, tmp_path / name, "-o", tmp_path / name[0], *how, *more)
        np.testing.assert_allclose(
            read_exr(tmp_path / name[0] / "depth" / "color.exr")["Z"], 3.0, 1e-5
        )
        assert "61.9°" in succeed("info", tmp_path / name, *how[:2], *more).out


def test_one_view_of_two_aspects_is_stretched(tmp_path):
    """Networks round the sides of a picture to multiples of 14 px."""
    depth, path = tmp_path / "d.npy", write(tmp_path / "a.exr", random_planes("RGB", (360, 640)))
    write_exr(tmp_path / "m.exr", Y=np.ones((147, 259), "f4"))
    how = ("--resize-depth", "nearest", "--outputs", "depth,render", "--matte", tmp_path / "m.exr")
    np.save(depth, np.full((147, 259), 2.0, "f4"))
    ran = photograph(path, depth, "-o", tmp_path / "o", *how)
    told = header(tmp_path / "o" / "render" / "a.exr")["defocus:depth_read_as"]
    assert "resized by nearest, stretched by 0.90%" in told
    assert "m.exr: 259x147 px, stretched by 0.90%" in ran.err
    np.save(depth, np.full((147, 250), 2.0, "f4"))
    refused(render(path, depth, "-o", tmp_path / "p", *how), 3, "wrong-size", depth)


def test_exr_of_relative_disparity_is_read(tmp_path):
    near_below = np.broadcast_to(np.linspace(0, 40, 16, dtype="f4")[:, None], (16, 24))
    path = write_exr(tmp_path / "a.exr", Z=near_below)
    for name in ("video-depth-anything", "depth-anything"):
        depth = read_depth(path, format=name, kind="disparity", range_mm=(1000.0, np.inf))
        assert np.isclose(depth.metres[-1, 0], 1)
        assert np.isclose(depth.metres[-2, 0], 15 / 14)
        assert np.isinf(depth.metres[0]).all()
    with refuses("out-of-range"):
        read_depth(path, kind="disparity", range_mm=(1000.0, np.inf))


@pytest.mark.parametrize("hole", [0.0, np.nan])
def test_negative_depth_with_holes_is_named_and_not_put_at_infinity(hole, color, out, tmp_path):
    z = np.full((16, 24), -3.0, "f4")
    z[:10] = hole
    path = write_exr(tmp_path / "z.exr", Pz=z)
    assert "houdini" in succeed("info", path).out
    for more in ((), ("--invalid", "far"), ("--invalid", "fill")):
        ran = run("render", color, path, "-o", out, *LENS, *more)
        refused(ran, 3, "invalid-depth", path)
        assert "houdini" in ran.err
    np.save(tmp_path / "n.npy", np.zeros((16, 24), "f4"))
    ran = run("render", color, tmp_path / "n.npy", "-o", out, *LENS, "--invalid", "far")
    refused(ran, 3, "invalid-depth", tmp_path / "n.npy")


def test_equal_channels_of_an_exr_are_one(color, out, tmp_path):
    depth = np.full((16, 24), 2.5, "f4")
    path = write_exr(tmp_path / "z.exr", R=depth, G=depth, B=depth)
    assert (read_depth(path).metres == 2.5).all()
    refused(run("render", path, "-o", out, *LENS), 3, "no-depth", path)
    unequal = write_exr(tmp_path / "y.exr", R=depth, G=depth, B=depth + 1)
    with refuses("no-depth"):
        read_depth(unequal)


def test_a_remedy_is_quoted(tmp_path):
    one = np.ones((4, 5), "f4")
    write(tmp_path / "a.exr", {"a b.Z": one, "c.Z": one})
    with refuses("ambiguous", "‹depth-channel› 'a b.Z'"):
        read_depth(tmp_path / "a.exr")
    assert (read_depth(tmp_path / "a.exr", channel="a b.Z").metres == 1).all()


def test_parts_keep_their_names(out, tmp_path):
    one = np.full((24, 32), 2.0, "f4")
    parts = {"N": dict.fromkeys("XYZ", one * 0.1), "rgba": random_planes("RGBA")}
    path = multi_part(tmp_path / "a.exr", **parts, depth={"Z": one})
    photograph(path, "-o", out)
    made = set(read_exr(out / "render" / "a.exr"))
    assert made == {*"RGBA", "N.X", "N.Y", "N.Z", "depth.Z"}
    named = random_planes(("rgba.red", "rgba.green", "rgba.blue"))
    assert "layer rgba as RGB" in read_color(write(tmp_path / "b.exr", named)).note


def test_names_with_brackets_that_are_there_are_no_patterns(tmp_path):
    folder = tmp_path / "[2024] shoot"
    write_exr(folder / "img[1].exr", R=RAMP, G=RAMP, B=RAMP, Z=RAMP + 1)
    lens = '[lens]\nfocal-length = "50mm"\nfnumber = 2\nfocus = "2m"\n'
    for number, name in enumerate(
        ("[2024] shoot/img[1].exr", "[2024] shoot", "[2024] shoot/*.exr")
    ):
        jobs = tmp_path / f"{number}.toml"
        jobs.write_text(f'[inputs]\ncolor = "{name}"\ndepth = "{name}"\n{lens}')
        succeed("batch", jobs, "-o", tmp_path / f"out{number}")
    jobs.write_text(f'[inputs]\ncolor = "no*.exr"\ndepth = "no*.exr"\n{lens}')
    refused(run("batch", jobs, "-o", tmp_path / "out"), 3, "empty", tmp_path / "no*.exr")


def test_a_codec_that_is_missing_is_no_damage(tmp_path):
    path = save(tmp_path / "a.tif", np.full((16, 24, 1), 2000, np.uint16), compression="none")
    data = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", data, 4)
    tags = range(at + 2, at + 2 + 12 * struct.unpack_from("<H", data, at)[0], 12)
    (place,) = [tag for tag in tags if struct.unpack_from("<H", data, tag) == (259,)]
    struct.pack_into("<H", data, place + 8, 34661)  # JBIG
    path.write_bytes(data)
    with refuses("unsupported", "codec", path=path):
        read_depth(path)


def test_the_one_over_z_of_nuke_is_named(color, out, tmp_path):
    depth = {"depth.Z": np.full((16, 24), 0.4, "f4")}
    path = write(tmp_path / "z.exr", depth, **{"nuke/version": "15.0"})
    assert "nuke-scanline" in photograph(color, path, "-o", out).err
