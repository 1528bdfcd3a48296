"""``defocus status``: how far a batch is, and what failed."""

import os
import time

import pytest
from batches import JOBS, jobs_file
from command_line import depth_exr, ramp, run

from defocus_core import run_batch


@pytest.mark.parametrize("is_merged", [False, True])
@pytest.mark.parametrize("hours", [-1, 0, 1])
def test_status_counts_what_is_left_whatever_the_clock_says(
    hours, is_merged, tmp_path, out, monkeypatch
):
    path, part = jobs_file(tmp_path, "a", "b"), ("--shard", "1/1") if is_merged else ()
    run("batch", path, "-o", out, *part)
    path.write_text(JOBS.replace("fnumber = 2", "fnumber = 4"))
    then = time.time() + 3600 * hours
    monkeypatch.setattr(time, "time", lambda: then)
    run("batch", path, "-o", out, "--limit", "1", *part)
    for _ in range(1 + is_merged):
        told = run("status", out, "--json").json
        assert (told["ok"], told["left"], told["again"], told["jobs"]) == (4, 3, 3, 4)
        run("merge", out)
    assert "4 done, 3 left, 3 of them to be done again, 4 jobs" in run("status", out).out


def test_status_counts_and_names_what_failed(tmp_path, out):
    path = jobs_file(tmp_path)
    depth_exr(tmp_path / "depth" / "a.exr", -ramp())
    run("batch", path, "-o", out)
    told = run("status", out).out
    assert told.startswith(f"{out}: 2 done, 2 failed, 4 jobs\n")
    assert "  input-unusable 2\n" in told
    assert f"a_focus2m: input-unusable: {tmp_path / 'depth' / 'a.exr'}: " in told
    shown = run("status", out, "--failures", "1", "--json").json
    assert (shown["ok"], shown["failed"], shown["left"]) == (2, 2, 0)
    assert [failure["sample_id"] for failure in shown["failures"]] == ["a_focus2m"]
    assert shown["reasons"] == {"input-unusable": 2}


def test_status_can_be_asked_while_a_batch_runs(tmp_path, out):
    seen = []

    def asked(job, record):
        seen.append((run("status", out, "--json").json, run("status", out).out))

    run_batch(jobs_file(tmp_path), out, ended=asked)
    told, words = seen[1]
    assert (told["ok"], told["left"], told["jobs"]) == (2, 2, 4)
    assert told["running"][0].startswith(f"process {os.getpid()} on ")
    assert "not running" not in words
