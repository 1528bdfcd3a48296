"""``defocus status``: how far a batch is, and what failed."""

import os

from batches import JOBS, jobs_file
from command_line import depth_exr, ramp, run

from defocus_cli.words.batch import progress_lines, progress_record
from defocus_core import run_batch
from defocus_core.batch.journal.progress import progress


def test_status_counts_no_job_twice_that_is_to_be_done_again(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out)
    path.write_text(JOBS.replace("fnumber = 2", "fnumber = 4"))
    run("batch", path, "-o", out, "--limit", "1")
    told = run("status", out, "--json").json
    assert (told["ok"], told["left"], told["again"], told["jobs"]) == (4, 3, 3, 4)
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
        found = progress(out, 10)
        seen.append((progress_record(found), [*progress_lines(out, found)]))

    run_batch(jobs_file(tmp_path), out, ended=asked)
    told, words = seen[1]
    assert (told["ok"], told["left"], told["jobs"]) == (2, 2, 4)
    assert told["running"][0].startswith(f"process {os.getpid()} on ")
    assert not any("not running" in line for line in words)
