"""Every mistake ends in one line that names the file, the problem and the remedy.

Exit code 2 is usage, 3 is input or output. Nothing is written.
"""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import (
    LENS,
    Ran,
    color_exr,
    depth_exr,
    files_under,
    pair,
    ramp,
    refused,
    render,
    run,
    texture,
    write_exr,
)
from image_files import multi_part, save, write_deep

from defocus_cli import engine


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def color(tmp_path: Path) -> Path:
    return color_exr(tmp_path / "color.exr")


@pytest.fixture
def depth(tmp_path: Path) -> Path:
    return depth_exr(tmp_path / "depth.exr")


def refused_input(ran: Ran, file: Path, *words: str) -> None:
    """Refused because of ``file``, with a remedy, and nothing written beside the inputs."""
    refused(ran, 3, *words)
    assert ran.err.startswith(f"defocus: {file}: ")
    assert "; " in ran.err
    assert not (file.parent / "out").exists()


def test_a_missing_file(color: Path, depth: Path, out: Path) -> None:
    missing = color.with_name("none.exr")
    refused_input(render(missing, depth, "-o", out), missing, "no such file")
    refused_input(render(color, missing, "-o", out), missing, "no such file")
    refused_input(render(missing, "-o", out), missing, "no such file")


def test_a_directory_for_a_file(color: Path, depth: Path, out: Path) -> None:
    refused_input(render(color, depth.parent, "-o", out), depth.parent, "is a directory")
    refused_input(render(color.parent, depth, "-o", out), color.parent, "is a directory")
    refused_input(run("info", color.parent), color.parent, "is a directory")


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.jpg", "a.tif", "a.hdr"])
def test_zero_bytes(name: str, depth: Path, color: Path, out: Path) -> None:
    empty = color.with_name(name)
    empty.touch()
    refused_input(render(empty, depth, "-o", out), empty, "empty")
    refused_input(render(color, empty, "-o", out), empty, "empty")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are Unicode")
def test_a_name_that_is_not_utf_8(color: Path, depth: Path, out: Path) -> None:
    odd = color.rename(color.with_name(os.fsdecode(b"\xff.exr")))
    for files in ((odd, depth), (odd,)):
        refused(render(*files, "-o", out), 3, "has a name that is not UTF-8; rename it")


@pytest.mark.parametrize(
    "stem", ["photo – ünï.v2.final", "-dash", "{a,b} %d", "new\nline", "🎞" * 50]
)
def test_any_other_name_will_do(stem: str, color: Path, depth: Path, out: Path) -> None:
    named = color.rename(color.with_name(f"{stem}.exr"))
    assert render("-o", out, "--preview", "--format", "png", "--", named, depth).code == 0
    assert files_under(out) == {f"render/{stem}.png", f"render/{stem}.preview.png"}


def truncated(path: Path, share: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_a_truncated_exr(share: float, color: Path, depth: Path, out: Path) -> None:
    truncated(color, share)
    refused_input(render(color, depth, "-o", out), color)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_a_truncated_depth_exr(share: float, color: Path, depth: Path, out: Path) -> None:
    truncated(depth, share)
    refused_input(render(color, depth, "-o", out), depth)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
def test_a_truncated_png(share: float, tmp_path: Path, depth: Path, out: Path) -> None:
    png = save(tmp_path / "a.png", (texture() * 255).astype(np.uint8))
    refused_input(render(truncated(png, share), depth, "-o", out), png)


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.jpg", "a.txt"])
def test_what_is_not_an_image(name: str, color: Path, depth: Path, out: Path) -> None:
    text = color.with_name(name)
    text.write_text("This is not an image, whatever its name says.\n" * 20)
    refused_input(render(text, depth, "-o", out), text)
    refused_input(render(color, text, "-o", out), text)
    refused_input(run("info", text), text)


def test_no_depth_channel_names_those_present(color: Path, out: Path) -> None:
    words = ("no depth channel", "B, G, R", "--depth-channel")
    refused_input(render(color, color, "-o", out), color, *words)
    refused_input(render(color, "-o", out), color, *words)


@pytest.mark.parametrize("kind", ["coc", "disparity"])
def test_a_map_in_px_is_no_depth(kind: str, tmp_path: Path, color: Path, out: Path) -> None:
    lone = write_exr(tmp_path / "lone.exr", **{kind: ramp()})
    refused_input(render(color, lone, "-o", out), lone, "no depth channel", kind)


def test_several_depth_candidates_are_listed(tmp_path: Path, color: Path, out: Path) -> None:
    path = write_exr(tmp_path / "z.exr", near_Z=ramp(), depth_Z=ramp(), other_depth=ramp())
    refused_input(render(color, path, "-o", out), path, "depth.Z, other.depth", "--depth-channel")
    assert render(color, path, "-o", out, "--depth-channel", "other.depth").code == 0


def test_several_colour_layers_are_listed(tmp_path: Path, depth: Path, out: Path) -> None:
    rgb = {channel: texture()[..., 0] for channel in "RGB"}
    path = multi_part(tmp_path / "c.exr", sun=rgb, lamp=rgb)
    refused_input(render(path, depth, "-o", out), path, "sun", "lamp", "--color-layer")
    assert render(path, depth, "-o", out, "--color-layer", "lamp").code == 0


def test_a_part_is_chosen_where_there_are_several(tmp_path: Path, depth: Path, out: Path) -> None:
    rgb = {channel: texture()[..., 0] for channel in "RGB"}
    path = multi_part(tmp_path / "c.exr", sun=rgb, lamp=rgb)
    assert render(path, depth, "-o", out, "--part", "1").code == 0
    refused(render(path, depth, "-o", out / "more", "--part", "2"), 3, f"{path}: has no part 2")


def test_sizes_that_differ(tmp_path: Path, color: Path, out: Path) -> None:
    small = depth_exr(tmp_path / "small.exr", ramp(12, 16))
    refused_input(render(color, small, "-o", out), small, "12x16", "24x16", str(color))


@pytest.mark.parametrize("bad", [np.nan, 0.0, -1.0])
def test_depth_that_is_none(bad: float, tmp_path: Path, color: Path, out: Path) -> None:
    metres = ramp()
    metres[7, 5] = metres[8, 1] = bad
    path = depth_exr(tmp_path / "z.exr", metres)
    refused_input(render(color, path, "-o", out), path, "2 pixels", "5,7")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_colour_that_is_not_finite(bad: float, tmp_path: Path, depth: Path, out: Path) -> None:
    pixels = texture()
    pixels[3, 4, 1] = bad
    path = color_exr(tmp_path / "c.exr", pixels)
    refused_input(render(path, depth, "-o", out), path, "1 pixels", "4,3")


def test_a_deep_exr(tmp_path: Path, color: Path, depth: Path, out: Path) -> None:
    deep = tmp_path / "deep.exr"
    write_deep(deep)
    refused_input(render(color, deep, "-o", out), deep, "deep")
    refused_input(render(deep, depth, "-o", out), deep, "deep")


def test_8_bit_depth(tmp_path: Path, color: Path, out: Path) -> None:
    path = save(tmp_path / "z.png", np.full((16, 24, 1), 9, np.uint8))
    refused_input(render(color, path, "-o", out), path, "8 bit", "16-bit PNG in millimetres")


@pytest.mark.parametrize("name", ["z.jpg", "z.txt", "z.npz", "z.bmp"])
def test_depth_of_another_format_names_those_that_hold_depth(
    name: str, tmp_path: Path, color: Path, out: Path
) -> None:
    path = tmp_path / name
    if name in ("z.jpg", "z.bmp"):
        save(path, (texture() * 255).astype(np.uint8))
    elif name == "z.npz":
        np.savez(path, depth=ramp())
    else:
        np.savetxt(path, ramp())
    words = ("EXR, PFM, NPY or float TIFF", "16-bit PNG in millimetres")
    refused_input(render(color, path, "-o", out), path, *words)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x93NUMPY\x01\xff\xfe", "is not a text file"),
        (b"PK\x03\x04\0\0", "is not a lens file"),
        (b"\xff\xfef\0n\0", "is not a text file"),
        (b"[" * 100_000, "is not TOML"),
        (b"fnumber = " + b"9" * 5000, "is not TOML"),
        (b"#" * (2**20 + 1), "is not a lens file"),
    ],
)
def test_a_lens_file_of_anything_else(
    data: bytes, words: str, tmp_path: Path, color: Path, depth: Path, out: Path
) -> None:
    path = tmp_path / "lens.toml"
    path.write_bytes(data)
    refused_input(run("render", color, depth, "-o", out, "--lens", path), path, words)


def test_a_lens_file_that_is_an_image_or_a_directory(color: Path, depth: Path, out: Path) -> None:
    remedy = 'give --lens a TOML file, with lines like focal-length = "50mm"'
    for path in (color, color.parent):
        refused_input(run("render", color, depth, "-o", out, "--lens", path), path, remedy)
    missing = color.parent / "none.toml"
    refused_input(
        run("render", color, depth, "-o", out, "--lens", missing), missing, "No such file"
    )


def test_a_key_misspelt_in_a_lens_file(color: Path, depth: Path, out: Path) -> None:
    for key in ("focal-lenght", "focal_length", "Focal-Length"):
        path = color.with_name("lens.toml")
        path.write_text(f'{key} = "50mm"\n')
        words = f"{path}: unknown key '{key}'; did you mean focal-length?"
        refused(run("render", color, depth, "-o", out, "--lens", path), 2, words)


def test_a_length_without_unit(color: Path, depth: Path, out: Path) -> None:
    ran = render(color, depth, "-o", out, "--focus", "2")
    refused(ran, 2)
    line = "defocus: --focus: '2' has no unit; write it with a unit, like 2m or 50mm\n"
    assert ran.err == line
    assert not out.exists()


def test_focus_nearer_than_the_focal_length(color: Path, depth: Path, out: Path) -> None:
    ran = render(color, depth, "-o", out, "--focus", "30mm")
    refused(ran, 2, "defocus: --focus: 30mm", "focal length 50mm")


def test_focus_at_a_depth_nearer_than_the_focal_length(
    tmp_path: Path, color: Path, out: Path
) -> None:
    near = depth_exr(tmp_path / "near.exr", ramp() / 100)
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus-at", "0,0")
    ran = run("render", color, near, "-o", out, *lens)
    refused(ran, 2, "defocus: --focus-at: ", str(near), "10mm", "focal length 50mm")


@pytest.mark.parametrize("pixel", ["24,0", "0,16", "-1,0"])
def test_focus_at_a_pixel_outside_the_image(
    pixel: str, color: Path, depth: Path, out: Path
) -> None:
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus-at", pixel)
    ran = run("render", color, depth, "-o", out, *lens)
    refused(ran, 2, "defocus: --focus-at: ", "24x16", "X from 0 to 23 and Y from 0 to 15")
    assert not out.exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ((), "--out: is missing"),
        (("-o", "{out}", "--focal-lenght", "50mm"), "no such option; did you mean --focal-length?"),
        (("-o", "{out}", "--fnumber"), "requires an argument; see 'defocus render --help'"),
        (("-o", "{out}", "--fnumber", "2"), "--focal-length: is missing; add --focal-length 50mm"),
        (("-o", "{out}", "--focal-length", "50mm", "--focus", "2m"), "--fnumber: is missing"),
        (("-o", "{out}", "--focal-length", "50mm", "--fnumber", "2"), "--focus: is missing"),
        (("-o", "{out}", *LENS, "--aperture-diameter", "25mm"), "--fnumber: contradicts"),
        (("-o", "{out}", *LENS, "--focus-at", "1,1"), "--focus: contradicts --focus-at"),
        (("-o", "{out}", *LENS, "more"), "unexpected extra argument"),
    ],
)
def test_usage(args: tuple[str, ...], words: str, color: Path, depth: Path, out: Path) -> None:
    filled = [arg.format(out=out) for arg in args]
    refused(run("render", color, depth, *filled), 2, words, "; ")
    assert not out.exists()


def test_usage_before_any_command() -> None:
    refused(run("bokeh"), 2, "bokeh", "--help")
    refused(run("render"), 2, "COLOR: is missing")
    refused(run("--nonsense"), 2, "--nonsense: no such option")


@pytest.mark.parametrize(
    ("args", "remedy"),
    [
        (("rendr",), "rendr: no such command; did you mean render?"),
        (("Info",), "did you mean info?"),
        (("bokeh",), "bokeh: no such command; see 'defocus --help'"),
        (("render", "--fnumer", "2"), "--fnumer: no such option; did you mean --fnumber?"),
        (("info", "--dept-unit", "mm"), "did you mean --depth-"),
    ],
)
def test_a_misspelt_word_is_met_with_the_nearest_known(args: tuple[str, ...], remedy: str) -> None:
    refused(run(*args), 2, remedy)


@pytest.mark.parametrize(
    "words",
    [
        ("--outputs", "render", "left", "coc"),
        ("--outputs", "render,", "left", ",coc"),
        ("--outputs=render", "left", "coc"),
    ],
)
def test_kinds_with_blanks_are_met_with_commas(
    words: tuple[str, ...], color: Path, depth: Path, out: Path
) -> None:
    remedy = "--outputs: blanks separate render left coc; write commas, like render,left,coc"
    refused(render(color, depth, "-o", out, *words), 2, remedy)
    refused(render(*words, color, depth, "-o", out), 2, remedy)
    refused(render(color, *words, "-o", out), 2, remedy)  # left would be the depth file
    assert not out.exists()


def test_a_file_named_like_a_kind_may_follow_the_kinds(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    color.rename(color.parent / "left")
    monkeypatch.chdir(color.parent)
    assert render("--outputs", "coc", "left", depth, "-o", out).code == 0


def test_no_arguments_show_help() -> None:
    ran = run()
    assert ran.code == 0
    assert "render" in ran.out


def test_cuda_that_is_not_there(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    refused(render(color, depth, "-o", out, "--device", "cuda"), 2, "--device: ", "cpu or auto")
    assert render(color, depth, "-o", out, "--device", "auto").code == 0


def test_an_output_directory_that_is_a_file(color: Path, depth: Path, out: Path) -> None:
    out.write_text("mine")
    for args in ((), ("--dry-run",), ("--overwrite",)):
        ran = render(color, depth, "-o", out, *args)
        refused(ran, 3, f"defocus: {out}: is a file where a directory is needed", "-o")
    assert out.read_text() == "mine"


def test_an_output_that_is_a_directory(color: Path, depth: Path, out: Path) -> None:
    (out / "render" / "color.exr").mkdir(parents=True)
    ran = render(color, depth, "-o", out, "--overwrite")
    refused(ran, 3, f"{out / 'render' / 'color.exr'}: ")
    assert files_under(out) == set()


@pytest.mark.parametrize("args", [("", "{z}"), ("{c}", ""), ("{c}", "{z}", "-o", ""), ("--lens",)])
def test_an_empty_path_is_not_the_current_directory(
    args: tuple[str, ...], color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(color.parent)
    filled = [arg.format(c=color, z=depth) for arg in args]
    lens = ["", color, depth] if args == ("--lens",) else []
    refused(render("-o", out, *filled, *lens), 2, "is empty; give a path")
    assert files_under(color.parent) == {"color.exr", "depth.exr"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read and write everything")
def test_what_may_not_be_read_or_written(color: Path, depth: Path, out: Path) -> None:
    color.chmod(0)
    refused_input(render(color, depth, "-o", out), color, "Permission denied")
    color.chmod(0o600)
    out.mkdir(mode=0o500)
    refused(render(color, depth, "-o", out), 3, f"{out}: cannot be written to")


@pytest.mark.parametrize("stderr", ["full", "closed"])
def test_words_that_cannot_be_said_do_not_cost_the_picture(
    stderr: str, color: Path, depth: Path, out: Path
) -> None:
    command = "import sys; from defocus_cli.main import main; sys.exit(main())"
    args = [sys.executable, "-c", command, "render", color, "-o", out, "--outputs", "coc", *LENS]
    redirected = "2>/dev/full" if stderr == "full" else "2>&-"
    for more, code in ((depth, 0), (color, 3)):
        shell = ["sh", "-c", f'exec "$@" {redirected}', "sh", *args, more, "--overwrite"]
        assert subprocess.run(shell, check=False).returncode == code
    assert files_under(out) == {"coc/color.exr"}


def test_a_full_disk(color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    for name in ("exr", "png", "jpg"):
        ran = render(color, depth, "-o", out, "--format", name, "--outputs", "render,coc")
        refused(ran, 3, str(out), "No space left on device; free some space")
        assert not out.exists()


def test_a_disk_that_fills_up_leaves_no_half_picture(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, calls = os.fsync, []

    def full_at_the_third(number: int) -> None:
        calls.append(number)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    monkeypatch.setattr(os, "fsync", full_at_the_third)
    ran = render(color, depth, "-o", out, "--outputs", "render,left,right")
    refused(ran, 3, "No space left")
    assert not out.exists()


def test_the_systems_own_errors_are_one_line(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO), "/mnt/disk")

    monkeypatch.setattr(engine, "run", broken)
    refused(render(color, depth, "-o", out), 3, "defocus: /mnt/disk: Input/output error; ")


def test_a_fault_of_our_own_asks_for_a_report(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(*_: object) -> None:
        raise RuntimeError("wires\ncrossed")

    monkeypatch.setattr(engine, "run", faulty)
    refused(render(color, depth, "-o", out), 1, "RuntimeError: wires crossed; please report")
    verbose = render(color, depth, "-o", out, "-v")
    assert verbose.code == 1
    assert "Traceback" in verbose.err


def test_the_process_itself_says_one_line_and_exits(color: Path, out: Path) -> None:
    command = "import sys; from defocus_cli.main import main; sys.exit(main())"
    ran = subprocess.run(
        [sys.executable, "-c", command, "render", color, "no.exr", "-o", out, *LENS],
        capture_output=True,
        text=True,
        check=False,
    )
    refused(Ran(ran.returncode, ran.stdout, ran.stderr), 3, "defocus: no.exr: no such file")


def test_ctrl_c_waits_for_imports_and_is_not_lost() -> None:
    def imports() -> None:
        with engine.interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done.append("imports")

    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        imports()
    assert done


def test_ctrl_c_ends_the_process_with_130_and_one_line(tmp_path: Path) -> None:
    files = [*pair(tmp_path), "-o", tmp_path / "out"]
    script = (
        "import sys, time; from defocus_cli import engine, main; "
        "engine.run = lambda *_: (print('up', flush=True), time.sleep(60)); "
        "sys.exit(main.main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, "render", *map(str, files), *LENS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=10)
    refused(Ran(process.returncode, "", err), 130, "interrupted")


def test_what_overwrite_replaced_comes_back_if_a_later_file_fails(
    color: Path, depth: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A good result of before is not lost to a disk that is full now."""
    kinds = ("--outputs", "render,left,right")
    assert render(color, depth, "-o", out, *kinds).code == 0
    before = {path: path.read_bytes() for path in out.rglob("*.exr")}
    assert len(before) == 3
    sync, calls = os.fsync, []

    def full_at_the_third(number: int) -> None:
        calls.append(number)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    monkeypatch.setattr(os, "fsync", full_at_the_third)
    ran = render(color, depth, "-o", out, *kinds, "--overwrite", "--quality", "draft")
    refused(ran, 3, "No space left")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_a_directory_in_the_place_of_an_output(color: Path, depth: Path, out: Path) -> None:
    (out / "render" / f"{color.stem}.exr").mkdir(parents=True)
    refused(render(color, depth, "-o", out, "--overwrite"), 3, "is a directory where a file")


def test_a_part_that_a_lone_scene_does_not_have(tmp_path: Path, out: Path) -> None:
    pixels = texture()
    scene = write_exr(
        tmp_path / "s.exr", R=pixels[..., 0], G=pixels[..., 1], B=pixels[..., 2], Z=ramp()
    )
    refused(render(scene, "-o", out, "--part", "3"), 3, "s.exr: has no part 3, only 1")
