"""What cannot be written, and work that is cut short: one line, and nothing lost or half done."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path

import pytest
from batches import again, records
from command_line import LENS, files_under, hidden_in, pair, photograph, refused, render, succeed

from defocus_cli import main
from defocus_core.picture import plain_path


def fill_at_the_third_file(monkeypatch):
    """The disk is full when the third file is to be kept."""
    sync, calls = os.fsync, []

    def full_at_the_third(number):
        calls.append(number)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(number)

    monkeypatch.setattr(os, "fsync", full_at_the_third)


def test_an_output_that_is_a_directory(color, depth, out):
    (out / "render" / "color.exr").mkdir(parents=True)
    ran = render(color, depth, "-o", out, "--overwrite")
    refused(ran, 3, "unwritable", "color.exr")
    assert files_under(out) == set()


COMMAND = "from defocus_cli.__main__ import run; run()"


def shell(redirected, *words):
    """A command of its own, whose output goes where no process of tests can send it."""
    args = ["sh", "-c", f'exec "$@" {redirected}', "sh", sys.executable, "-c", COMMAND, *words]
    return subprocess.run(list(map(str, args)), capture_output=True, text=True, check=False)


@contextmanager
def disk(path):
    """A stream to a full disk; None for one that is closed."""
    if path is None:
        yield None
        return
    with suppress(OSError), Path(path).open("w") as stream:  # which cannot be closed in peace
        yield stream


@pytest.mark.parametrize(("stderr", "redirected"), [("/dev/full", "2>/dev/full"), (None, "2>&-")])
def test_words_that_cannot_be_said_do_not_cost_the_picture(stderr, redirected, color, depth, out):
    words = ("render", str(color), "-o", str(out), "--outputs", "coc", *LENS, "--overwrite")
    with disk(stderr) as stream, redirect_stderr(stream):
        codes = [main.main([*words, str(more)]) for more in (depth, color)]
    assert codes == [0, 3]
    assert files_under(out) == {"coc/color.exr"}
    assert shell(redirected, "rendr").returncode == 2


@pytest.mark.parametrize(
    ("stdout", "redirected", "problem"),
    [
        ("/dev/full", ">/dev/full", "cannot be written: No space left on device; free some space"),
        (None, ">&-", "is closed"),
    ],
)
def test_a_document_that_cannot_be_told_is_an_error(
    stdout, redirected, problem, color, depth, out, capfd
):
    done = ["render", str(color), str(depth), "-o", str(out), "--outputs", "coc", "--json", *LENS]
    succeed(*done)
    for words in (done, ["info", str(color)], ["info", str(color), "--json"], ["status", str(out)]):
        capfd.readouterr()
        with disk(stdout) as stream, redirect_stdout(stream):
            assert main.main(words) == 3
        told = capfd.readouterr().err.splitlines()
        assert told[-1].startswith(f"defocus: stdout: {problem}")
        assert len(told) == 1 + (words is done)
    for words in (["help", "depth"], ["--version"], []):
        ran = shell(redirected, *words)
        assert (ran.returncode, ran.stderr.count("\n")) == (3, 1)


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


def test_errors_of_the_system_are_one_line_and_faults_ask_for_a_report(
    color, depth, out, monkeypatch
):
    faults = [OSError(errno.EIO, os.strerror(errno.EIO), "/mnt/disk")]
    faults += [RuntimeError("wires\ncrossed")] * 2

    def faulty(*_):
        raise faults.pop(0)

    monkeypatch.setattr(plain_path, "compute", faulty)
    ran = render(color, depth, "-o", out)
    refused(ran, 3, None)
    assert ran.err.startswith("defocus: /mnt/disk: ")
    ran = render(color, depth, "-o", out)
    refused(ran, 1, None)
    assert "RuntimeError: wires crossed" in ran.err
    verbose = render(color, depth, "-o", out, "-v")
    assert verbose.code == 1
    assert "Traceback" in verbose.err


def signalled(monkeypatch, module, name, *numbers, at=1):
    """Signals come while a step is at its work for the so many-th time."""
    do, calls = getattr(module, name), []

    def step(*args, **named):
        calls.append(name)
        for number in numbers if len(calls) == at else ():
            os.kill(os.getpid(), number)
            time.sleep(0.2)  # what can be read ahead is read
        return do(*args, **named)

    monkeypatch.setattr(module, name, step)


def test_ctrl_c_ends_a_lone_picture_with_130_and_one_line(color, depth, out, monkeypatch):
    signalled(monkeypatch, plain_path, "compute", signal.SIGINT)
    refused(render(color, depth, "-o", out), 130, None)


def test_ctrl_c_finishes_what_was_begun_and_the_rest_is_left(folders, out, monkeypatch):
    with monkeypatch.context() as patched:
        signalled(patched, plain_path, "compute", signal.SIGINT)
        ran = again(folders, out)
    assert ran.code == 130
    assert "finishing what is being rendered; press Ctrl-C again" in ran.err
    assert len(records(out)) == 1, "what was read ahead is left"
    last = ran.err.splitlines()[-1]
    assert last.startswith("defocus: interrupted, 2 of 3 jobs left; run the same")
    assert again(folders, out).code == 0
    assert len(records(out)) == 3


def test_ctrl_c_again_stops_at_once(folders, out, monkeypatch):
    signalled(monkeypatch, plain_path, "compute", signal.SIGINT, signal.SIGINT)
    ran = again(folders, out)
    first, last = ran.err.splitlines()
    assert (ran.code, "press Ctrl-C again" in first) == (130, True)
    assert last == "defocus: interrupted; pictures that were finished are kept"


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_the_system_ends_a_run_which_leaves_nothing_half_written(name, folders, out, monkeypatch):
    number = signal.Signals[name]
    with monkeypatch.context() as patched:  # the first that is replaced is the run's own note
        signalled(patched, os, "replace", number, number, at=2)
        ran = again(folders, out)
    assert ran.code == 128 + number
    last = f"defocus: ended by {name}; pictures that were finished are kept"
    assert ran.err.splitlines()[-1] == last
    assert hidden_in(out) <= {".journal.run"}
    assert {path.stem for path in (out / "coc").iterdir()} >= {r["sample_id"] for r in records(out)}
    assert again(folders, out).code == 0
    assert len(records(out)) == 3
    assert not hidden_in(out)


def test_what_overwrite_replaced_comes_back_if_a_later_file_fails(color, depth, out, monkeypatch):
    """A good result of before is not lost to a disk that is full now."""
    kinds = ("--outputs", "render,left,right")
    photograph(color, depth, "-o", out, *kinds)
    before = {path: path.read_bytes() for path in out.rglob("*.exr")}
    assert len(before) == 3
    fill_at_the_third_file(monkeypatch)
    ran = render(color, depth, "-o", out, *kinds, "--overwrite", "--quality", "high")
    refused(ran, 3, "unwritable", "color.exr")
    assert {path: path.read_bytes() for path in out.rglob("*.exr")} == before
    assert files_under(out) == {str(path.relative_to(out)) for path in before}
