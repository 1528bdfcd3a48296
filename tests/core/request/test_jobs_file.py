"""Jobs files: tables become jobs, and what a file says wrong is told with its key."""

import math

import pytest
from jobs_files import FIXED, LENS, jobs, jobs_file, names, touch
from refusals import refuses, refuses_as

from defocus_core.request.job import Machine, Outputs, Reading
from defocus_core.request.jobs_file import read_jobs
from defocus_core.request.lens import Lens


def test_every_table_reaches_the_job(tmp_path):
    text = """
[reading]
depth-unit = "cm"
depth-channel = "Z"
color-layer = "beauty"
part = 1
[outputs]
kinds = ["render", "coc"]
format = "jpeg"
preview = true
[machine]
quality = "high"
depth-repair = "off"
"""
    outputs = Outputs(tmp_path / "o", overwrite=True)
    job = read_jobs(jobs_file(tmp_path, FIXED + text), outputs, Machine(device="cpu", threads=3))[0]
    assert job.lens == Lens(50.0, 2.0, 2000.0)
    taken = {"depth_unit": "cm", "depth_channel": "Z", "color_layer": "beauty", "part": 1}
    assert job.reading == Reading(**taken, depth_repair="off")
    kinds = ("render", "coc")
    assert job.outputs == Outputs(tmp_path / "o", kinds, "jpg", preview=True, overwrite=True)
    assert job.machine == Machine("high", device="cpu", threads=3)
    (job,) = jobs(tmp_path, FIXED + '[outputs]\nexr-type = "float"\n')
    assert job.outputs.exr_type == "float"
    (job,) = jobs(tmp_path, FIXED + '[outputs]\nformat = "jpg"\njpeg-quality = 80\n')
    assert job.outputs.jpeg_quality == 80


def test_what_a_file_does_not_say_is_as_told(tmp_path):
    outputs = Outputs(tmp_path / "o", ("left",), "png16")
    machine = Machine("high", device="cuda", threads=2)
    job = read_jobs(jobs_file(tmp_path, FIXED), outputs, machine)[0]
    assert (job.outputs, job.machine, job.reading) == (outputs, machine, Reading())
    assert job.sample_id == "a"


def test_a_lens_file_lies_below_the_options_of_the_jobs_file(tmp_path):
    (tmp_path / "l.toml").write_text('focal-length = "85mm"\nfnumber = 2\nfocus = inf\n')
    text = '[lens]\nfile = "l.toml"\nfnumber = 4\n'
    assert jobs(tmp_path, text)[0].lens == Lens(85.0, 4.0, math.inf)
    text = '[lens]\nfile = "l.toml"\n[sweep]\nfocus = ["2m"]\n'
    assert jobs(tmp_path, text)[0].lens == Lens(85.0, 2.0, 2000.0)


def test_all_lenses_of_a_picture_follow_one_another(tmp_path):
    touch(tmp_path, "1.exr", "2.exr")
    found = jobs(tmp_path, FIXED + "[sweep]\nblades = [0, 5]\n", inputs='color = "*.exr"')
    assert names(found) == ["1_blades0", "1_blades5", "2_blades0", "2_blades5"]


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("[len]\n", "unknown-name"),
        ("lens = 1\n", "unknown-name [inputs]"),
        ("[lens]\nfocus-length = 1\n", "unknown-name [lens]"),
        (FIXED + "[outputs]\nkinds = ['rendre']\n", "unknown-name kinds"),
        (FIXED + "[outputs]\nkinds = []\n", "malformed kinds"),
        (FIXED + "[outputs]\nformat = 'gif'\n", "unknown-name format"),
        (FIXED + "[outputs]\nexr-type = 'double'\n", "unknown-name exr-type"),
        (FIXED + "[outputs]\nexr-type = 'half'\nformat = 'jpg'\n", "idle-option exr-type"),
        (FIXED + "[outputs]\njpeg-quality = 101\nformat = 'jpg'\n", "malformed jpeg-quality"),
        (FIXED + "[outputs]\njpeg-quality = 80\n", "idle-option jpeg-quality"),
        (FIXED + "[outputs]\npreview = 1\n", "malformed preview"),
        (FIXED + "[outputs]\nout = 'o'\n", "unknown-name [outputs]"),
        (FIXED + "[machine]\nquality = 'hihg'\n", "unknown-name quality"),
        (FIXED + "[machine]\nthreads = 2\n", "unknown-name [machine]"),
        (FIXED + "[reading]\ndepth-unit = 'km'\n", "unknown-name depth-unit"),
        (FIXED + "[reading]\npart = -1\n", "malformed part"),
        (FIXED + "file = 'no.toml'\n", "not-found"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(tmp_path, text, refusal):
    with refuses_as(refusal):
        jobs(tmp_path, text)


@pytest.mark.parametrize("text", ["[inputs", "\0", "\xff", "inputs = 3\n"])
def test_what_is_no_toml_or_no_table_is_refused(tmp_path, text):
    (tmp_path / "jobs.toml").write_bytes(text.encode("latin-1"))
    with refuses("malformed"):
        read_jobs(tmp_path / "jobs.toml", Outputs(tmp_path), Machine())


def test_more_jobs_than_anybody_means_are_refused_before_they_are_made(tmp_path):
    text = (
        LENS
        + 'focus = "2m"\n[sweep]\nblades = [5, 6, 7, 8, 9, 10, 11]\nblade-rotation = "0..9 @ 9"\n'
    )
    text += '[sample]\nn = 1000000\nseed = 1\nfnumber = "uniform(2, 4)"\n'
    with refuses("out-of-range"):
        jobs(tmp_path, text)
