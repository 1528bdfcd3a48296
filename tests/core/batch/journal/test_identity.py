"""A job is known by what decides its outputs, and by nothing else."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from jobs_files import Machine, Outputs, PictureFiles, Reading, job_of

from defocus_core.batch.journal import resume
from defocus_core.errors import Place
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.lens import Draw

JOB = job_of(Path("in/a.exr"), Path("in/z.exr"), Path("out"))
PICTURE = JOB.picture
DRAW = Draw(7, "a", 3)
HIDDEN = replace(PICTURE, hidden=PictureFiles("b", Path("b.exr"), Path("c.exr")))


def test_where_and_by_whom_it_is_done_is_no_part_of_a_job():
    elsewhere = replace(
        JOB,
        picture=replace(PICTURE, color=Path("/far/a.exr"), depth=Path("/far/z.exr")),
        outputs=Outputs(Path("/elsewhere"), overwrite=True),
        machine=Machine(device="cpu", threads=8),
        lens=replace(JOB.lens, focus_source=Place("lens.toml")),
    )
    assert resume.recipe(elsewhere) == resume.recipe(JOB)


@pytest.mark.parametrize(
    "change",
    [
        {"lens": replace(JOB.lens, fnum=2.1)},
        {"lens": replace(JOB.lens, draw=DRAW)},
        {"reading": Reading(depth_unit="cm")},
        {"outputs": Outputs(Path("out"), kinds=("render", "coc"))},
        {"outputs": Outputs(Path("out"), exr_type="float")},
        {"machine": Machine(quality="high")},
        {"reading": Reading(depth_repair="off")},
        {"reading": Reading(edge_width=4.0)},
        {"suffix": "_f2"},
        {"picture": replace(PICTURE, depth=Path("in/other.exr"))},
        {"picture": HIDDEN},
    ],
)
def test_what_decides_the_outputs_is(change):
    assert resume.recipe(replace(JOB, **change)) != resume.recipe(JOB)


def test_the_version_of_the_renderer_is_that_of_the_core_and_is_read_without_torch():
    code = (
        "import sys; from defocus_core.batch.journal.resume import versions;"
        "print(versions()['renderer'], 'torch' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == [str(RENDERER_VERSION), "False"]


def test_a_file_is_unchanged_by_size_and_time_or_else_by_its_bytes(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    stamp = resume.stamp(path)
    assert resume.unchanged(path, stamp)
    os.utime(path)
    assert resume.unchanged(path, stamp), "touched, not changed"
    path.write_bytes(b"abd")
    assert not resume.unchanged(path, stamp)
    os.utime(path, ns=(0, stamp.mtime_ns))
    assert resume.unchanged(path, stamp), "cannot be seen from outside"
    assert not resume.unchanged(path, stamp, read=True)
    path.write_bytes(b"abcd")
    assert not resume.unchanged(path, stamp)
    assert not resume.unchanged(tmp_path / "none", stamp)


def test_a_time_that_is_only_just_past_is_not_relied_on(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    fresh = resume.settled_stamp(path)
    assert fresh.mtime_ns is None
    assert resume.unchanged(path, fresh)
    path.write_bytes(b"abd")
    assert not resume.unchanged(path, fresh)
    os.utime(path, (0, 0))
    assert resume.settled_stamp(path).mtime_ns == 0
