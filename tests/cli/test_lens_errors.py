"""A lens that makes no sense, in a file or in options, ends in one line that says what would do."""

import pytest
from command_line import depth_exr, ramp, refused, refused_input, run

from defocus_core.request import toml_file


@pytest.mark.parametrize(
    "data",
    [
        b"\x93NUMPY\x01\xff\xfe",
        b"PK\x03\x04\0\0",
        b"\xff\xfef\0n\0",
        b"[" * 100_000,
        b"fnumber = " + b"9" * 5000,
    ],
)
def test_a_lens_file_of_anything_else(data, tmp_path, color, depth, out):
    path = tmp_path / "lens.toml"
    path.write_bytes(data)
    refused_input(run("render", color, depth, "-o", out, "--lens", path), path, "malformed")


def test_a_lens_file_that_never_ends_is_not_read_to_its_end(color, depth, out):
    path = color.with_name("lens.toml")
    path.write_bytes(b"#" * (toml_file.LARGEST_FILE + 1))
    ran = run("render", color, depth, "-o", out, "--lens", path)
    refused_input(ran, path, "malformed")


def test_a_lens_file_that_is_an_image_or_a_directory(color, depth, out):
    of_folder = color.with_suffix(".toml")
    for path, read, code in (
        (color, color, "malformed"),
        (color.parent, of_folder, "not-found"),
    ):
        refused_input(run("render", color, depth, "-o", out, "--lens", path), read, code)
    missing = color.parent / "none.toml"
    refused_input(run("render", color, depth, "-o", out, "--lens", missing), missing, "not-found")


def test_a_blur_beyond_all_numbers(color, depth, out):
    lens = ("--focal-length", "50mm", "--fnumber", "1e-300", "--focus", "2m")
    refused(run("render", color, depth, "-o", out, *lens), 2, "out-of-range", "fnumber")
    assert not out.exists()
    refused(run("info", depth, *lens), 2, "out-of-range", "fnumber")


def test_focus_at_a_depth_nearer_than_the_focal_length(tmp_path, color, out):
    near = depth_exr(tmp_path / "near.exr", ramp() / 100)
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus-at", "0,0")
    ran = run("render", color, near, "-o", out, *lens)
    refused(ran, 2, "out-of-range", "focus-at")


def test_a_focus_that_a_file_has_is_blamed_on_the_file(tmp_path, color, depth, out):
    options = 'focal-length = "50mm"\nfnumber = 2\nfocus-at = [24, 0]\n'
    lens, jobs = tmp_path / "lens.toml", tmp_path / "jobs.toml"
    lens.write_text(options)
    jobs.write_text(f'[inputs]\ncolor = "{color}"\ndepth = "{depth}"\n[lens]\n{options}')
    rendering = ("render", color, depth, "-o", out, "--lens", lens)
    refused(run(*rendering), 2, "out-of-range", lens, "focus-at")
    refused(run("info", depth, "--lens", lens), 2, "out-of-range", lens, "focus-at")
    refused(run(*rendering, "--focus-at", "24,0"), 2, "out-of-range", "focus-at")
    assert f"defocus: {jobs}: [lens] focus-at: " in run("batch", jobs, "-o", out).err
    depth_exr(depth, ramp() / 100)
    lens.write_text(options.replace("24", "0"))
    refused(run(*rendering), 2, "out-of-range", lens, "focus-at")
