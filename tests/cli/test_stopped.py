"""Whatever stops a run, kill -9 and Ctrl-C, the same command goes on where it was."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batches import contents, records
from command_line import LENS, pair, render, run
from shots import pull

HERE = Path(__file__).parents[1] / "support"
COMMAND = "from defocus_cli.__main__ import run; run()"


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    for number in range(16):
        color, depth = pair(tmp_path, f"{number:02}")
    return color.parent, depth.parent


def test_killed_runs_come_to_the_same_end(folders: tuple[Path, Path], tmp_path: Path) -> None:
    """A shortened run of what is done by hand with 100 kills of 300 jobs in several processes."""
    outputs = ("--outputs", "render,coc", "--preview")
    render(*folders, "-o", tmp_path / "whole", *outputs)
    out = tmp_path / "killed"
    journal = out / "journal.jsonl"
    words = ["render", *folders, "-o", out, *outputs, *LENS]
    runner = [sys.executable, HERE / "killed_runs.py", "3", "12", journal, "--", *words]
    told = json.loads(subprocess.run(runner, capture_output=True, check=True).stdout)
    assert told["killed"] >= 5
    assert (told["lies"], told["code"]) == (0, 0)
    assert contents(out) == contents(tmp_path / "whole")
    names = [record["sample_id"] for record in records(out)]
    assert sorted(names) == [f"{number:02}" for number in range(16)], "none is done twice"


def test_a_shot_that_is_killed_comes_to_the_same_end(tmp_path: Path) -> None:
    """Frames that decide together and average each other's depth, with another lens each."""
    jobs = pull(tmp_path)
    render_batch = ("batch", jobs, "-o")
    assert run(*render_batch, tmp_path / "whole").code == 0
    out = tmp_path / "killed"
    journal, words = out / "journal.jsonl", [*render_batch, out]
    runner = [sys.executable, HERE / "killed_runs.py", "5", "4", journal, "--", *words]
    told = json.loads(subprocess.run(runner, capture_output=True, check=True).stdout)
    assert told["killed"] >= 2
    assert (told["lies"], told["code"]) == (0, 0)
    assert contents(out) == contents(tmp_path / "whole")
    assert sorted(each["sample_id"] for each in records(out)) == [f"rgb.{k:04}" for k in range(10)]


def started(*args: object, slow: float, step: str = "plain_path.compute") -> subprocess.Popen[str]:
    """A run of which a step takes its time; it says when the first picture comes to it."""
    script = (
        "import os, sys, time; from defocus_cli import main\n"
        "from defocus_core.picture import plain_path\n"
        f"do = {step}\n"
        "def slowly(*args, **named):\n"
        "    print('up', flush=True)\n"
        f"    time.sleep({slow})\n"
        "    return do(*args, **named)\n"
        f"{step} = slowly\n"
        "sys.exit(main.main())"
    )
    words = [sys.executable, "-c", script, "render", *map(str, args), "--outputs", "coc", *LENS]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(words, text=True, **pipes)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    return process


def test_ctrl_c_finishes_what_was_begun_and_the_rest_is_left(
    folders: tuple[Path, Path], out: Path
) -> None:
    process = started(*folders, "-o", out, slow=0.5)
    time.sleep(0.2)  # the next is read
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert "finishing what is being rendered; press Ctrl-C again" in err
    done = len(records(out))
    assert done == 1, "what was read ahead is left"
    last = err.splitlines()[-1]
    assert last.startswith(f"defocus: interrupted, {16 - done} of 16 jobs left; run the same")
    ran = render(*folders, "-o", out, "--outputs", "coc")
    assert ran.code == 0
    assert len(records(out)) == 16


def test_ctrl_c_again_stops_at_once(folders: tuple[Path, Path], out: Path) -> None:
    process = started(*folders, "-o", out, slow=30)
    assert process.stderr is not None
    process.send_signal(signal.SIGINT)
    assert "press Ctrl-C again" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert err == "defocus: interrupted; pictures that were finished are kept\n"


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_the_system_ends_a_run_which_leaves_nothing_half_written(
    name: str, folders: tuple[Path, Path], out: Path
) -> None:
    process = started(*folders, "-o", out, slow=0.3, step="os.replace")
    number = signal.Signals[name]
    assert process.stdout is not None
    process.stdout.readline()  # the first was the run's own note
    process.send_signal(number)
    process.send_signal(number)
    _, err = process.communicate()
    assert process.returncode == 128 + number
    assert err.splitlines()[-1] == f"defocus: ended by {name}; pictures that were finished are kept"
    assert {path.name for path in out.rglob(".*")} <= {".journal.run"}
    assert {path.stem for path in (out / "coc").iterdir()} >= {r["sample_id"] for r in records(out)}
    assert render(*folders, "-o", out, "--outputs", "coc").code == 0
    assert len(records(out)) == 16
    assert not list(out.rglob(".*"))
