"""Whatever stops a run, kill -9 or a full disk, the same command goes on where it was."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from batches import jobs_file
from command_line import LENS, color_exr, pair, run, texture
from shots import pull

SCRIPT = Path(__file__).parents[1] / "support" / "stopped_at_steps.py"
EVERY = int(os.environ.get("DEFOCUS_EVERY", "0"))  # 1 stops at each step, which takes an hour


def pictures_of(folder):
    for stem in "abc":
        color, depth = pair(folder, stem)
    outputs = ("--outputs", "render,coc", "--preview", "--format", "jpg")
    return ("render", color.parent, depth.parent, *outputs, *LENS, "-o", folder / "work" / "o")


def shot_of(folder):
    """Frames that decide together, with another lens each."""
    pull(folder)
    files = (folder / "rgb.####.exr", folder / "z.####.exr", "--animate", folder / "pull.csv")
    return ("render", *files, "--focal-length", "50mm", "-o", folder / "work" / "o")


def batch_of(folder):
    (folder / "in").mkdir()
    jobs = jobs_file(folder / "in", "a", "b")
    return ("batch", jobs, "--processes", "1", "-o", folder / "work" / "o")


def sharded(folder):
    return (*batch_of(folder), "--shards-size", "1MB")


def merge_of(folder):
    words = batch_of(folder)
    for shard in ("1/2", "2/2"):
        assert run(*words, "--shard", shard).code == 0
    return ("merge", folder / "work" / "o")


def accepted(folder):
    for name in "abcde":
        color_exr(folder / "new" / f"{name}.exr", texture(8, 8))
        color_exr(folder / "work" / "old" / f"{name}.exr", texture(8, 8) / 2)
    return ("compare", folder / "work/old", folder / "new", "--accept", "--processes", "1")


@pytest.mark.parametrize(
    ("stop", "words_of", "every"),
    [
        ("kill", pictures_of, 97),
        ("full", pictures_of, 83),
        ("kill", shot_of, 397),
        ("full", sharded, 397),
        ("kill", merge_of, 47),
        ("kill", accepted, 47),
    ],
)
def test_a_run_stopped_at_any_step_leaves_what_goes_on_to_the_same_end(
    stop, words_of, every, tmp_path
):
    (tmp_path / "work").mkdir()
    words = [sys.executable, SCRIPT, stop, EVERY or every, tmp_path / "work", "--"]
    command = list(map(str, (*words, *words_of(tmp_path))))
    told = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert {each["code"] for each in told} == {-9 if stop == "kill" else 3}
    assert [e for e in told if e["halves"] or e["lies"] or e["again"] or e["differ"]] == []
