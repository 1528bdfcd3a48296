"""Whatever stops a run, kill -9 and Ctrl-C, the same command goes on where it was."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from batches import contents, jobs_file, records
from command_line import LENS, color_exr, pair, run, texture
from shots import pull

SCRIPT = Path(__file__).parents[1] / "support" / "stopped_at_steps.py"
OUTPUTS = ("--outputs", "render,coc", "--preview")


def stopped(*words):
    """What the script tells of a command that is stopped."""
    command = list(map(str, (sys.executable, SCRIPT, *words)))
    return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)


def pictures_of(folder):
    for number in range(6):
        color, depth = pair(folder, f"{number:02}")
    return ("render", color.parent, depth.parent, *OUTPUTS, *LENS, "-o")


def shot_of(folder):
    """Frames that decide together and average each other's depth, with another lens each."""
    pull(folder)
    files = (folder / "rgb.####.exr", folder / "z.####.exr", "--animate", folder / "pull.csv")
    return ("render", *files, "--focal-length", "50mm", "-o")


@pytest.mark.parametrize(("words_of", "count", "kills"), [(pictures_of, 6, 3), (shot_of, 10, 3)])
def test_killed_runs_come_to_the_same_end(words_of, count, kills, tmp_path):
    """A shortened run of what is done by hand with 100 kills of 300 jobs in several processes."""
    words, whole, out = words_of(tmp_path), tmp_path / "whole", tmp_path / "killed"
    assert run(*words, whole).code == 0
    told = stopped("random", 3, kills, out / "journal.jsonl", "--", *words, out)
    assert told["killed"] > kills / 2
    assert (told["lies"], told["code"]) == (0, 0)
    assert contents(out) == contents(whole)
    names = [record["sample_id"] for record in records(out)]
    assert len(names) == len(set(names)) == count, "none is done twice"


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
    "every", [397, pytest.param(1, marks=pytest.mark.bench)], ids=["some", "each"]
)
def test_a_disk_full_at_any_step_of_a_batch_leaves_what_goes_on(every, tmp_path):
    (tmp_path / "work").mkdir()
    words = batch_of(tmp_path, "a", "b")
    told = stopped("full", every, tmp_path / "work", "--", *words, "--shards-size", "1MB")
    require_whole(told, 3)


@pytest.mark.parametrize(
    "every", [47, pytest.param(1, marks=pytest.mark.bench)], ids=["some", "each"]
)
def test_a_merge_killed_at_any_step_goes_on(every, tmp_path):
    (tmp_path / "work").mkdir()
    words = batch_of(tmp_path, "a", "b")
    for shard in ("1/2", "2/2"):
        assert run(*words, "--shard", shard).code == 0
    require_whole(
        stopped("kill", every, tmp_path / "work", "--", "merge", tmp_path / "work" / "o"), -9
    )


@pytest.mark.bench
@pytest.mark.parametrize("reports", [(), ("--html", "work/r.html", "--junit", "work/j.xml")])
def test_a_comparison_killed_at_any_step_accepts_all_the_same(reports, tmp_path, here):
    for name in "abcde":
        color_exr(tmp_path / "new" / f"{name}.exr", texture(8, 8))
        color_exr(tmp_path / "work" / "old" / f"{name}.exr", texture(8, 8) / 2)
    words = ("compare", "work/old", "new", "--accept", "--processes", "1", *reports)
    told = stopped("kill", 9 if reports else 1, tmp_path / "work", "--", *words)
    require_whole(told, -9, ("r.html", "j.xml"))
