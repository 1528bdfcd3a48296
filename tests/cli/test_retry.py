"""``defocus retry``: what failed, once more."""

import numpy as np
from batches import JOBS, contents, jobs_file
from command_line import depth_exr, ramp, refused, run, succeed

from defocus_core.batch.journal.lock import locked


def test_retry_of_what_another_does_is_refused_before_a_word_is_said(tmp_path, out):
    run("batch", jobs_file(tmp_path), "-o", out)
    with locked(out):
        refused(run("retry", out), 3, "in-use", ".journal.lock")


def test_retry_needs_no_jobs_file(tmp_path, out):
    path = jobs_file(tmp_path)
    good = (tmp_path / "depth" / "a.exr").read_bytes()
    depth_exr(tmp_path / "depth" / "a.exr", -ramp())
    run("batch", path, "-o", out)
    path.unlink()
    assert run("retry", out).code == 1
    (tmp_path / "depth" / "a.exr").write_bytes(good)
    assert "nothing failed for that reason" in run("retry", out, "--reason", "worker-died").err
    ran = succeed("retry", out, "--reason", "input-unusable", "--json")
    assert ran.json["ok"] == 2
    jobs_file(tmp_path)
    run("batch", path, "-o", tmp_path / "whole")
    assert contents(out) == contents(tmp_path / "whole")
    assert "nothing failed" in run("retry", out).err


def test_retry_keeps_the_picture_of_the_opening(tmp_path, out):
    opening = np.zeros((9, 9), np.float32)
    opening[2:7, 4] = 1
    np.save(tmp_path / "opening.npy", opening)
    text = JOBS.replace("[lens]", '[lens]\naperture-image = "opening.npy"')
    text = text.replace('kinds = ["coc"]', 'kinds = ["render"]')
    path = jobs_file(tmp_path, text=text)
    good = (tmp_path / "depth" / "a.exr").read_bytes()
    depth_exr(tmp_path / "depth" / "a.exr", -ramp())
    assert run("batch", path, "-o", out).code == 1
    (tmp_path / "depth" / "a.exr").write_bytes(good)
    succeed("retry", out)
    run("batch", path, "-o", tmp_path / "whole")
    assert contents(out) == contents(tmp_path / "whole")
