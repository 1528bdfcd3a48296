"""Whatever stops a run, kill -9 and Ctrl-C, the same command goes on where it was."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from batches import contents, jobs_file, records
from command_line import LENS, color_exr, pair, render, run, texture
from shots import pull

HERE = Path(__file__).parents[1] / "support"


@pytest.fixture
def folders(tmp_path):
    for number in range(16):
        color, depth = pair(tmp_path, f"{number:02}")
    return color.parent, depth.parent


def test_killed_runs_come_to_the_same_end(folders, tmp_path):
    """A shortened run of what is done by hand with 100 kills of 300 jobs in several processes."""
    outputs = ("--outputs", "render,coc", "--preview")
    render(*folders, "-o", tmp_path / "whole", *outputs)
    out = tmp_path / "killed"
    journal = out / "journal.jsonl"
    words = ["render", *folders, "-o", out, *outputs, *LENS]
    runner = [sys.executable, HERE / "killed_runs.py", "3", "8", journal, "--", *words]
    told = json.loads(subprocess.run(runner, capture_output=True, check=True).stdout)
    assert told["killed"] >= 5
    assert (told["lies"], told["code"]) == (0, 0)
    assert contents(out) == contents(tmp_path / "whole")
    names = [record["sample_id"] for record in records(out)]
    assert sorted(names) == [f"{number:02}" for number in range(16)], "none is done twice"


def test_a_shot_that_is_killed_comes_to_the_same_end(tmp_path):
    """Frames that decide together and average each other's depth, with another lens each."""
    pull(tmp_path)
    lens = ("--focal-length", "50mm", "--animate", tmp_path / "pull.csv")
    shot = ("render", tmp_path / "rgb.####.exr", tmp_path / "z.####.exr", *lens, "-o")
    assert run(*shot, tmp_path / "whole").code == 0
    out = tmp_path / "killed"
    journal, words = out / "journal.jsonl", [*shot, out]
    runner = [sys.executable, HERE / "killed_runs.py", "5", "3", journal, "--", *words]
    told = json.loads(subprocess.run(runner, capture_output=True, check=True).stdout)
    assert told["killed"] >= 2
    assert (told["lies"], told["code"]) == (0, 0)
    assert contents(out) == contents(tmp_path / "whole")
    assert sorted(each["sample_id"] for each in records(out)) == [f"rgb.{k:04}" for k in range(10)]


def rounds(mode, every, folder, *words):
    """What comes of a command that is killed, or finds no space, at every so many steps."""
    script = [sys.executable, HERE / "stopped_at_steps.py", mode, every, folder, "--", *words]
    ran = subprocess.run(list(map(str, script)), capture_output=True, check=True)
    told: list[dict[str, Any]] = json.loads(ran.stdout)
    return told


def require_whole(told, code, reports=()):
    """Nothing was half-written, and all went on to the end that a run comes to undisturbed.

    Reports tell of the last run, for which a stopped one may have left less to tell.
    """
    assert {each["code"] for each in told} == {code}
    wrong = [e for e in told if e["halves"] or e["again"] or not {*e["differ"]} <= {*reports}]
    assert wrong == []


def batch_of(folder, *stems):
    (folder / "in").mkdir()
    return ("batch", jobs_file(folder / "in", *stems), "--processes", "1", "-o", folder / "work/o")


@pytest.mark.parametrize(
    "every", [97, pytest.param(1, marks=pytest.mark.bench)], ids=["some", "each"]
)
def test_a_disk_full_at_any_step_of_a_batch_leaves_what_goes_on(every, tmp_path):
    (tmp_path / "work").mkdir()
    words = batch_of(tmp_path, "a", "b")
    require_whole(rounds("full", every, tmp_path / "work", *words, "--shards-size", "1MB"), 3)


@pytest.mark.parametrize(
    "every", [31, pytest.param(1, marks=pytest.mark.bench)], ids=["some", "each"]
)
def test_a_merge_killed_at_any_step_goes_on(every, tmp_path):
    (tmp_path / "work").mkdir()
    words = batch_of(tmp_path, "a", "b")
    for shard in ("1/2", "2/2"):
        assert run(*words, "--shard", shard).code == 0
    require_whole(rounds("kill", every, tmp_path / "work", "merge", tmp_path / "work" / "o"), -9)


@pytest.mark.bench
@pytest.mark.parametrize("reports", [(), ("--html", "work/r.html", "--junit", "work/j.xml")])
def test_a_comparison_killed_at_any_step_accepts_all_the_same(reports, tmp_path, here):
    for name in "abcde":
        color_exr(tmp_path / "new" / f"{name}.exr", texture(8, 8))
        color_exr(tmp_path / "work" / "old" / f"{name}.exr", texture(8, 8) / 2)
    words = ("compare", "work/old", "new", "--accept", "--processes", "1", *reports)
    told = rounds("kill", 9 if reports else 1, tmp_path / "work", *words)
    require_whole(told, -9, ("r.html", "j.xml"))


@pytest.mark.bench
def test_an_update_of_goldens_killed_at_any_step_goes_on(tmp_path):
    (tmp_path / "in").mkdir()
    jobs, folder = jobs_file(tmp_path / "in", "a", "b"), tmp_path / "work" / "goldens"
    words = ("--accept", "--processes", "1", "--threads", "1")
    assert run("golden", "update", jobs, folder, *words).code == 0
    jobs.write_text(jobs.read_text().replace('"2m"]', '"3m"]').replace("50mm", "60mm"))
    told = rounds("kill", 11, tmp_path / "work", "golden", "update", jobs, folder, *words)
    require_whole(told, -9)


@pytest.mark.bench
def test_a_report_killed_at_any_step_goes_on(tmp_path):
    (tmp_path / "work").mkdir()
    words = batch_of(tmp_path, "a", "b")
    assert run(*words).code == 0
    require_whole(rounds("kill", 5, tmp_path / "work", "report", tmp_path / "work" / "o"), -9)
