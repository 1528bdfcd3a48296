"""What cannot be written, and work that is cut short: one line, and nothing lost or half done."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from command_line import LENS, Ran, files_under, pair, photograph, refused, render, succeed

from defocus_core.picture import plain_path
from defocus_core.system.interrupts import delayed_signals


def fill_at_the_third_file(monkeypatch):
    """The disk is full when the third file is to be kept."""
    sync, calls = os.fsync, []

    def full_at_the_third(number):
        calls.append(number)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    monkeypatch.setattr(os, "fsync", full_at_the_third)


def test_an_output_directory_that_is_a_file(color, depth, out):
    out.write_text("mine")
    for args in ((), ("--dry-run",), ("--overwrite",)):
        ran = render(color, depth, "-o", out, *args)
        refused(ran, 3, "wrong-type", out)
    assert out.read_text() == "mine"


def test_an_output_that_is_a_directory(color, depth, out):
    (out / "render" / "color.exr").mkdir(parents=True)
    ran = render(color, depth, "-o", out, "--overwrite")
    refused(ran, 3, "wrong-type", "color.exr")
    assert files_under(out) == set()


@pytest.mark.parametrize("stderr", ["full", "closed"])
def test_words_that_cannot_be_said_do_not_cost_the_picture(stderr, color, depth, out):
    command = "from defocus_cli.__main__ import run; run()"
    args = [sys.executable, "-c", command, "render", color, "-o", out, "--outputs", "coc", *LENS]
    redirected = "2>/dev/full" if stderr == "full" else "2>&-"
    for more, code in ((depth, 0), (color, 3)):
        shell = ["sh", "-c", f'exec "$@" {redirected}', "sh", *args, more, "--overwrite"]
        assert subprocess.run(shell, check=False).returncode == code
    assert files_under(out) == {"coc/color.exr"}


@pytest.mark.parametrize(
    ("redirected", "words"),
    [
        (">/dev/full", "cannot be written: No space left on device; free some space"),
        (">&-", "is closed"),
    ],
)
def test_a_document_that_cannot_be_told_is_an_error(redirected, words, color, depth, out):
    command = "from defocus_cli.__main__ import run; run()"
    done = ["render", color, depth, "-o", out, "--outputs", "coc", "--json", *LENS]
    succeed(*done)
    for args in (done, ["info", color], ["info", color, "--json"], ["status", out]):
        shell = ["sh", "-c", f'exec "$@" {redirected}', "sh", sys.executable, "-c", command, *args]
        ran = subprocess.run(shell, capture_output=True, text=True, check=False)
        told = ran.stderr.splitlines()
        assert (ran.returncode, told[-1].startswith(f"defocus: stdout: {words}")) == (3, True)
        assert len(told) == 1 + (args is done)


def test_a_full_disk(color, depth, out, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    for name in ("exr", "png", "jpg"):
        ran = render(color, depth, "-o", out, "--format", name, "--outputs", "render,coc")
        refused(ran, 3, "unwritable", ".journal.run")
        assert not out.exists()


def test_a_disk_that_fills_up_leaves_no_half_picture(color, depth, out, monkeypatch):
    fill_at_the_third_file(monkeypatch)
    ran = render(color, depth, "-o", out, "--outputs", "render,left,right")
    refused(ran, 3, "unwritable", "color.exr")
    assert not out.exists()


def test_a_disk_that_fills_up_during_a_batch_names_the_file(tmp_path, out, monkeypatch):
    for stem in "ab":
        color, depth = pair(tmp_path, stem)
    fill_at_the_third_file(monkeypatch)
    refused(render(color.parent, depth.parent, "-o", out), 3, "no-space", out / "render" / "a.exr")


def test_a_file_that_another_worker_wrote_meanwhile_stays(color, depth, out, monkeypatch):
    """A cluster may do a job twice; the one that comes to grief takes back its own files alone."""

    def full(*_, **__):
        other = out / "render" / "other"
        other.write_text("theirs")
        other.replace(out / "render" / "color.exr")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("defocus_core.picture.write.write_exr", full)
    refused(render(color, depth, "-o", out, "--outputs", "render,coc"), 3, None)
    assert (out / "render" / "color.exr").read_text() == "theirs"


@pytest.mark.parametrize("at", ["compute", "write"])
@pytest.mark.parametrize("again", [False, True])
def test_an_output_directory_that_is_removed_meanwhile_ends_the_run(
    again, at, tmp_path, out, monkeypatch
):
    for stem in "ab":
        color, depth = pair(tmp_path, stem)
    step = getattr(plain_path, at)

    def removing(*args):
        done = step(*args)
        shutil.rmtree(out)
        if again:
            out.mkdir()
        return done

    monkeypatch.setattr(plain_path, at, removing)
    ran = render(color.parent, depth.parent, "-o", out, "--outputs", "coc")
    refused(ran, 3, "unwritable", ".journal.lock")
    assert again or not out.exists()


def test_the_systems_own_errors_are_one_line(color, depth, out, monkeypatch):
    def broken(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO), "/mnt/disk")

    monkeypatch.setattr(plain_path, "compute", broken)
    ran = render(color, depth, "-o", out)
    refused(ran, 3, None)
    assert ran.err.startswith("defocus: /mnt/disk: ")


def test_a_fault_of_our_own_asks_for_a_report(color, depth, out, monkeypatch):
    def faulty(*_):
        raise RuntimeError("wires\ncrossed")

    monkeypatch.setattr(plain_path, "compute", faulty)
    ran = render(color, depth, "-o", out)
    refused(ran, 1, None)
    assert "RuntimeError: wires crossed" in ran.err
    verbose = render(color, depth, "-o", out, "-v")
    assert verbose.code == 1
    assert "Traceback" in verbose.err


def test_ctrl_c_waits_for_imports_and_is_not_lost():
    def imports():
        with delayed_signals():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done.append("imports")

    done: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        imports()
    assert done


def test_ctrl_c_ends_the_process_with_130_and_one_line(tmp_path):
    files = [*pair(tmp_path), "-o", tmp_path / "out"]
    script = (
        "import sys, time; from defocus_cli import main\n"
        "from defocus_core.picture import plain_path\n"
        "plain_path.compute = lambda *_: (print('up', flush=True), time.sleep(60)); "
        "sys.exit(main.main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, "render", *map(str, files), *LENS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "up\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    refused(Ran(process.returncode, "", err), 130, None)


def test_what_overwrite_replaced_comes_back_if_a_later_file_fails(color, depth, out, monkeypatch):
    """A good result of before is not lost to a disk that is full now."""
    kinds = ("--outputs", "render,left,right")
    photograph(color, depth, "-o", out, *kinds)
    before = {path: path.read_bytes() for path in out.rglob("*.exr")}
    assert len(before) == 3
    fill_at_the_third_file(monkeypatch)
    ran = render(color, depth, "-o", out, *kinds, "--overwrite", "--quality", "draft")
    refused(ran, 3, "unwritable", "color.exr")
    assert {path: path.read_bytes() for path in out.rglob("*.exr")} == before
    assert files_under(out) == {str(path.relative_to(out)) for path in before}
