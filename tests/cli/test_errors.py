"""Every mistake ends in one line that names the file, the problem and the remedy.

Exit code 2 is usage, 3 is input or output. Nothing is written.
"""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import (
    LENS,
    color_exr,
    files_under,
    pair,
    photograph,
    refused,
    refused_input,
    render,
    run,
    succeed,
    texture,
    write_exr,
)
from image_files import save

from defocus_core.errors import CODES


def test_json_of_a_command_that_has_no_result_is_its_error(tmp_path, color):
    missing = tmp_path / "none"
    asked = {("info", missing): 3, ("status", missing): 3, ("batch", missing, "-o", "out"): 3}
    for words, code in {**asked, ("info",): 2, ("render", missing, "-o", "out", *LENS): 3}.items():
        ran = run(*words, "--json")
        message = ran.err.removeprefix("defocus: ").removesuffix("\n")
        error = ran.json["error"]
        assert error["code"] in {*CODES, None}
        assert (error["message"], error["exit_code"], ran.code) == (message, code, code)
    assert "error" not in run("info", color, missing, "--json").json
    assert run("info", missing).out == ""


def test_a_link_that_leads_nowhere(color, depth, out):
    circle = color.with_name("a")
    circle.symlink_to("a")
    for ran in (
        *(render(*args, "-o", out) for args in ((circle, depth), (color, circle), (circle,))),
        *(render(color, depth, "-o", circle), run("info", circle)),
    ):
        refused_input(ran, circle, "not-found")
    lost = color.with_name("b")
    lost.symlink_to("none")
    refused_input(render(color, depth, "-o", lost), lost, "not-found")


def test_a_link_in_a_folder_that_leads_in_a_circle(tmp_path, out):
    for stem in "ab":
        color, depth = pair(tmp_path, stem)
    color.unlink()
    color.symlink_to(color.name)
    ran = render(color.parent, depth.parent, "-o", out, "--outputs", "coc")
    assert ran.code == 1
    assert f"defocus: {color}: is a symbolic link that leads to nothing" in ran.err
    assert files_under(out) == {"coc/a.exr"}


def test_names_that_would_steer_a_terminal_are_told_escaped(color, depth, out):
    odd = color.rename(color.with_name("a\n\x1b[31mb\u3000é.exr"))
    told = "a\\n\\x1b[31mb\u3000é"
    refused(render(odd.with_suffix(".png"), depth, "-o", out), 3, "not-found", f"{told}.png")
    refused(render(odd, odd, "-o", out), 3, "no-depth", f"{told}.exr")
    for ran in (render(odd, depth, "-o", out, "-v"), render(odd, depth, "-o", out)):
        assert ran.code == 0
        assert f"{told}: " in ran.err
        assert f"/{told}.exr" in ran.err
        assert "\x1b" not in ran.err
    for ran in (run("info", odd), render(odd, depth, "-o", out, "--dry-run")):
        assert told in ran.out
        assert "\x1b" not in ran.out


def socket_at(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


@pytest.mark.parametrize("make", [os.mkfifo, lambda p: p.symlink_to("/dev/zero"), socket_at])
def test_what_is_no_regular_file(make, color, out, monkeypatch):
    """Of a pipe, the first byte may never come; of /dev/zero, the last."""
    monkeypatch.chdir(color.parent)
    odd = Path("odd.exr")  # the name of a socket must be short
    make(odd)
    for ran in (render(color, odd, "-o", out), render(odd, color, "-o", out), run("info", odd)):
        refused_input(ran, odd, "wrong-type")
    assert render(color, odd, "-o", out, "--dry-run").code == 3


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_zero_bytes(name, depth, color, out):
    empty = color.with_name(name)
    empty.touch()
    refused_input(render(empty, depth, "-o", out), empty, "empty")
    refused_input(render(color, empty, "-o", out), empty, "empty")


@pytest.mark.skipif(sys.platform != "linux", reason="not on this system: names are Unicode")
def test_a_name_that_is_not_utf_8(color, depth, out):
    odd = color.rename(color.with_name(os.fsdecode(b"\xff.exr")))
    for files in ((odd, depth), (odd,)):
        refused(render(*files, "-o", out), 3, "not-utf-8", "\\udcff.exr")


@pytest.mark.parametrize(
    "stem", ["photo – ünï.v2.final", "-dash", "{a,b} %d", "new\nline", "🎞" * 50]
)
def test_any_other_name_will_do(stem, color, depth, out):
    named = color.rename(color.with_name(f"{stem}.exr"))
    photograph("-o", out, "--preview", "--format", "png", "--", named, depth)
    assert files_under(out) == {f"render/{stem}.png", f"render/{stem}.preview.png"}


def truncated(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


@pytest.mark.parametrize("share", [0.05, 0.9])
def test_a_truncated_file(share, color, depth, out):
    png = truncated(save(color.with_name("a.png"), (texture() * 255).astype(np.uint8)), share)
    refused_input(render(png, depth, "-o", out), png, "damaged", "unreadable")
    whole = depth.read_bytes()
    refused_input(render(color, truncated(depth, share), "-o", out), depth, "damaged")
    depth.write_bytes(whole)
    refused_input(render(truncated(color, share), depth, "-o", out), color, "damaged")


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.txt"])
def test_what_is_not_an_image(name, color, depth, out):
    text = color.with_name(name)
    text.write_text("This is not an image, whatever its name says.\n" * 20)
    refused_input(render(text, depth, "-o", out), text, "wrong-type", "unreadable")
    refused_input(render(color, text, "-o", out), text, "wrong-type", "unreadable")
    refused_input(run("info", text), text, "unreadable")


def test_a_lone_grey_channel_is_not_its_own_depth(tmp_path, out):
    for name in ("Y", "pass.y"):
        grey = write_exr(tmp_path / "grey.exr", **{name: texture()[..., 0] + 1})
        for more in ((), ("--dry-run",)):
            ran = render(grey, "-o", out, *more)
            refused_input(ran, grey, "no-depth")


@pytest.mark.parametrize("name", ["c.bmp", "c.dpx"])
def test_colour_of_another_format_is_refused_alone_as_in_a_folder(name, tmp_path, depth, out):
    path = save(tmp_path / "in" / name, (texture() * 255).astype(np.uint8))
    ran = render(path, depth, "-o", out)
    refused_input(ran, path, "wrong-type")
    refused_input(render(path.parent, depth.parent, "-o", out), path.parent, "empty")
    refused_input(run("info", path), path, "wrong-type")


def test_no_arguments_show_help():
    ran = succeed()
    assert "render" in ran.out


@pytest.mark.skipif(torch.cuda.is_available(), reason="not on this system: it has a GPU")
def test_cuda_that_is_not_there(color, depth, out):
    refused(render(color, depth, "-o", out, "--device", "cuda"), 2, "no-gpu", "device")
    photograph(color, depth, "-o", out, "--device", "auto")


@pytest.mark.parametrize(
    ("args", "at"),
    [
        (("", "{z}"), "COLOR"),
        (("{c}", ""), "DEPTH"),
        (("{c}", "{z}", "-o", ""), "out"),
        (("--lens", "", "{c}", "{z}"), "lens"),
    ],
)
def test_an_empty_path_is_not_the_current_directory(args, at, color, depth, out, monkeypatch):
    monkeypatch.chdir(color.parent)
    filled = [arg.format(c=color, z=depth) for arg in args]
    refused(render("-o", out, *filled), 2, "empty", at)
    assert files_under(color.parent) == {"color.exr", "depth.exr"}


@pytest.mark.parametrize("module", ["defocus_cli", "defocus_cli.main"])
def test_the_package_is_the_command(module):
    words = [sys.executable, "-m", module, "--version"]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("defocus ")


def test_one_schema_tells_of_a_picture_that_fails_alone_and_beside_others(tmp_path, out):
    for stem in "ab":
        color, depth = pair(tmp_path, stem)
    color_exr(depth)  # which has no depth
    lone = render(color, depth, "-o", out, "--json")
    both = render(color.parent, depth.parent, "-o", out, "--json")
    assert (lone.code, both.code) == (3, 1)
    assert lone.json.keys() - both.json.keys() == {"error"}
    (picture,) = lone.json["pictures"]
    assert picture == both.json["pictures"][1]
    assert (picture["status"], picture["reason"]) == ("failed", "input-unusable")
    assert lone.json["error"] == {
        "message": picture["message"],
        "exit_code": 3,
        "code": lone.error.code,
    }
