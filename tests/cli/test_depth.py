"""``defocus depth`` writes planar metres; reading options mean the same in every command."""

from pathlib import Path

import numpy as np
import pytest
from batches import records
from command_line import (
    color_exr,
    depth_exr,
    header,
    pair,
    photograph,
    ramp,
    read_exr,
    refused,
    render,
    run,
    succeed,
    write_exr,
)
from depth_files import npy, pfm, png
from image_files import samples_of


def depth(*args):
    """The depth that a conversion to the file after ``-o`` writes."""
    succeed("depth", *args)
    return read_exr(Path(args[args.index("-o") + 1]))["Z"]


def coc(out, *args):
    """The radii that a rendering by the lens of most tests tells."""
    photograph(*args, "-o", out, "--outputs", "coc")
    (file,) = (out / "coc").glob("*.exr")
    return read_exr(file)["coc"]


def test_one_file_becomes_one_exr(tmp_path):
    path = png(tmp_path / "a.png", np.round(ramp() * 256))
    written = depth(path, "--depth-format", "kitti", "-o", tmp_path / "o" / "z.exr")
    np.testing.assert_allclose(written, np.round(ramp() * 256) / 256)
    attributes = header(tmp_path / "o" / "z.exr")
    assert attributes["defocus:depth_read_as"] == "16-bit PNG, kitti"
    assert attributes["defocus:depth"] == "a.png"


def test_what_was_written_is_read_as_it_is(tmp_path):
    path = npy(tmp_path / "a.npy", [[1.0, 1e5], [2.0, 7.0]])
    once = depth(path, "--depth-format", "tartanair", "-o", tmp_path / "once.exr")
    assert once[0, 1] == np.inf
    again = depth(tmp_path / "once.exr", "-o", tmp_path / "again.exr")
    np.testing.assert_array_equal(once, again)


def test_several_files_go_to_a_directory_and_one_that_fails_alone_fails(tmp_path):
    files = [npy(tmp_path / f"{name}.npy", [[1.0, value]]) for name, value in (("a", 2), ("b", 0))]
    ran = run("depth", *files, "-o", tmp_path / "o", "--json")
    assert ran.code == 3
    assert f"{files[1]}: is NaN or ≤ 0 in 1 pixel" in ran.err
    (record,) = ran.json["files"]
    assert record["out"] == str(tmp_path / "o" / "a.exr")
    assert (record["size"], record["range_m"]) == ([2, 1], [1.0, 2.0])
    assert not (tmp_path / "o" / "b.exr").exists()
    ran = run("depth", files[1], "-o", tmp_path / "o", "--json", "--invalid", "far")
    (record,) = ran.json["files"]
    assert (record["sky_pixels"], record["replaced_pixels"]) == (1, 1)
    assert record["range_m"] == [1.0, 1.0]


def test_files_are_replaced_only_with_overwrite_and_inputs_never(tmp_path):
    path = depth_exr(tmp_path / "a.exr")
    out = tmp_path / "z.exr"
    depth(path, "-o", out)
    before = out.read_bytes()
    refused(run("depth", path, "-o", out, "--depth-unit", "cm"), 3, "exists", out)
    assert out.read_bytes() == before
    changed = depth(path, "-o", out, "--depth-unit", "cm", "--overwrite")
    np.testing.assert_allclose(changed, ramp() / 100, rtol=1e-6)
    refused(run("depth", path, "-o", tmp_path, "--overwrite"), 3, "replaces-input", path)


def test_the_preview_is_brightest_where_it_is_nearest(tmp_path):
    path = npy(tmp_path / "a.npy", [[1.0, 4.0, np.inf]])
    depth(path, "-o", tmp_path / "z.exr", "--preview")
    shown = samples_of(tmp_path / "z.preview.png")[0, :, 0]
    assert shown[0] == 255
    assert shown[0] > shown[1] > shown[2] == 0


def test_16_bits_without_a_unit_are_millimetres_and_that_is_said(tmp_path):
    color = color_exr(tmp_path / "a.exr")
    path = png(tmp_path / "z.png", np.round(ramp() * 1000))
    words = "z.png: 16 bits read as millimetres; give --depth-unit or --depth-format"
    assert words in render(color, path, "-o", tmp_path / "o").err
    assert words not in render(color, path, "-o", tmp_path / "p", "--depth-unit", "mm").err
    assert words in run("depth", path, "-o", tmp_path / "z.exr").err


@pytest.mark.parametrize(
    ("said", "factor", "words"),
    [
        (("--depth-scale", "1"), 1, "millimetres, × 1: 1 is 0.001 m"),
        (("--depth-scale", "1/5"), 0.2, "millimetres, × 0.2: 1 is 0.0002 m"),
        (("--depth-scale", "1/1000", "--depth-unit", "m"), 1, "metres, × 0.001: 1 is 0.001 m"),
        (("--depth-scale", "2", "--depth-format", "kitti"), 2000 / 256, "× 2: 1 is 0.0078125 m"),
    ],
)
def test_the_unit_that_holds_without_a_scale_holds_beside_it(said, factor, words, tmp_path):
    path = png(tmp_path / "z.png", np.round(ramp() * 1000))
    (record,) = run("info", "--json", path, *said).json["files"]
    np.testing.assert_allclose(record["depth"]["range_m"], [factor, 4 * factor], rtol=1e-6)
    assert words in run("info", path, *said).out


def test_a_format_means_the_same_in_render_info_batch_and_lens_files(tmp_path):
    color, _ = pair(tmp_path)
    path = png(tmp_path / "z.png", np.round(ramp() * 256))
    as_metres = write_exr(tmp_path / "z.exr", Z=np.float32(np.round(ramp() * 256) / 256))
    wanted, said = coc(tmp_path / "o", color, as_metres), ("--depth-format", "kitti")
    np.testing.assert_array_equal(coc(tmp_path / "p", color, path, *said), wanted)
    (record,) = run("info", "--json", path, *said).json["files"]
    assert record["depth"]["range_m"] == [1.0, 4.0]
    lens = 'focal-length = "50mm"\nfnumber = 2\nfocus = "2m"\n'
    (tmp_path / "kitti.toml").write_text(f'{lens}depth-format = "kitti"\n')
    inputs = f'[inputs]\ncolor = "{color}"\ndepth = "{path}"\n[outputs]\nkinds = ["coc"]\n'
    tables = (f'[lens]\n{lens}[reading]\ndepth-format = "kitti"\n', '[lens]\nfile = "kitti.toml"\n')
    for number, text in enumerate(tables):
        (tmp_path / "jobs.toml").write_text(inputs + text)
        out = tmp_path / f"b{number}"
        succeed("batch", tmp_path / "jobs.toml", "-o", out, "--processes", "1")
        np.testing.assert_array_equal(read_exr(out / "coc" / "a.exr")["coc"], wanted)


def test_depth_of_another_size_is_guided_by_the_colours(tmp_path):
    """A bright square before a dark wall; a cell of depth covers 4 by 4 px of both."""
    inside = (slice(9, 51), slice(13, 67))
    pixels, metres = np.full((64, 80, 3), 0.1, np.float32), np.full((64, 80), 6, np.float32)
    pixels[inside], metres[inside] = 0.8, 1.5
    color, whole = color_exr(tmp_path / "a.exr", pixels), depth_exr(tmp_path / "z.exr", metres)
    small = depth_exr(tmp_path / "s.exr", metres[2::4, 2::4].copy())
    exact, found = coc(tmp_path / "whole", color, whole), {}
    for how in ("guided", "nearest"):
        found[how] = coc(tmp_path / how, color, small, "--resize-depth", how)
        assert (np.abs(found[how] - exact) > 1e-3).any() == (how == "nearest")
        note = f"20x16 px resized{', guided by the colours' if how == 'guided' else ' by nearest'}"
        assert note in (tmp_path / how / "journal.jsonl").read_text()
    text = 'focal-length = "50mm"\nfnumber = 2\nfocus = "2m"\nresize-depth = "guided"\n'
    (tmp_path / "lens.toml").write_text(text)
    args = (color, small, "--outputs", "coc")
    succeed("render", *args, "-o", tmp_path / "toml", "--lens", tmp_path / "lens.toml")
    np.testing.assert_array_equal(
        read_exr(tmp_path / "toml" / "coc" / "a.exr")["coc"], found["guided"]
    )
    little = coc(tmp_path / "mm", color, small, "--resize-depth", "guided", "--memory", "1GB")
    np.testing.assert_array_equal(little, found["guided"])


def test_signed_radii_are_used_as_they_are_and_need_no_lens(tmp_path):
    color, path = pair(tmp_path)
    radii = np.float32(ramp() * 2 - 5)
    held = write_exr(tmp_path / "coc.exr", coc=radii)
    said = ("--depth-format", "coc", "--outputs", "render,coc")
    succeed("render", color, held, "-o", tmp_path / "o", *said)
    np.testing.assert_array_equal(read_exr(tmp_path / "o" / "coc" / "a.exr")["coc"], radii)
    render(color, path, "-o", tmp_path / "p", "--outputs", "render,coc", "--exr-type", "float")
    own = tmp_path / "p" / "coc" / "a.exr"  # written by us: the picture is the same again
    run("render", color, own, "-o", tmp_path / "q", *said, "--exr-type", "float")
    of = [read_exr(tmp_path / name / "render" / "a.exr")["R"] for name in "pq"]
    np.testing.assert_allclose(of[1], of[0], atol=1e-5)
    shown = run("info", held, "--depth-format", "coc").out
    assert "negative nearer than the focus): -3.00 to 3.00 px" in shown
    assert " m to " not in shown


def test_a_sidecar_or_mask_that_changes_is_a_changed_input(tmp_path):
    color = color_exr(tmp_path / "a.exr")
    disparity = pfm(tmp_path / "d.pfm", 10 / ramp())
    calib = "cam0=[10 0 1; 0 1 1; 0 0 1]\nbaseline={}\n"
    (tmp_path / "calib.txt").write_text(calib.format(1000))
    args = (color, disparity, "-o", tmp_path / "o", "--depth-format", "middlebury")
    photograph(*args, "--outputs", "coc")
    before = read_exr(tmp_path / "o" / "coc" / "a.exr")["coc"]
    assert "done before" in render(*args, "--outputs", "coc").err
    (tmp_path / "calib.txt").write_text(calib.format(2000))
    photograph(*args, "--outputs", "coc")
    after = read_exr(tmp_path / "o" / "coc" / "a.exr")["coc"]
    assert (after > before).all()
    sidecar = records(tmp_path / "o")[-1]["inputs"]["depth_sidecar"]
    assert sidecar["path"].endswith("calib.txt")


def test_a_pfm_beside_calib_txt_is_not_converted_without_a_word(tmp_path):
    path = pfm(tmp_path / "disp0.pfm", ramp())
    (tmp_path / "calib.txt").write_text("cam0=[1 0 0; 0 1 0; 0 0 1]\n")
    ran = run("depth", path, "-o", tmp_path / "a.exr", "--json")
    (warning,) = ran.json["files"][0]["warnings"]
    assert "--depth-format middlebury" in warning
    assert ran.err == f"warning: {warning}\n"
    ran = run("depth", path, "-o", tmp_path / "b.exr", "--depth-format", "metres", "--json")
    assert ran.json["files"][0]["warnings"] == []


def test_radial_depth_takes_the_field_of_view_of_the_lens(tmp_path):
    color, path = pair(tmp_path)
    radial = coc(tmp_path / "o", color, path, "--radial")
    fov = np.degrees(2 * np.arctan(18 / 50))  # of LENS
    found = coc(tmp_path / "p", color, path, "--radial", "--fov", f"{fov!s}")
    np.testing.assert_allclose(found, radial, atol=1e-6)
    assert np.abs(coc(tmp_path / "q", color, path, "--planar") - radial).max() > 1e-3
    text = f'[inputs]\ncolor = "{color}"\ndepth = "{path}"\n[lens]\nfnumber = 2\nfocus = "2m"\n'
    text += '[sweep]\nfocal-length = ["25mm", "50mm"]\n[reading]\nradial = true\n'
    (tmp_path / "jobs.toml").write_text(f'{text}[outputs]\nkinds = ["coc"]\n')
    succeed("batch", tmp_path / "jobs.toml", "-o", tmp_path / "b", "--processes", "1")
    (swept,) = (tmp_path / "b" / "coc").glob("*50mm*")
    np.testing.assert_array_equal(read_exr(swept)["coc"], radial)


@pytest.mark.parametrize(("sign", "scale"), [(1, "-1"), (-1, "2")])
def test_depth_behind_the_camera_is_told_to_change_its_sign_whatever_it_is(sign, scale, tmp_path):
    path = depth_exr(tmp_path / "a.exr", sign * ramp())
    ran = run("depth", path, "-o", tmp_path / "z.exr", "--depth-scale", scale)
    refused(ran, 3, "invalid-depth", path)
    assert "the other sign than now" in ran.err
