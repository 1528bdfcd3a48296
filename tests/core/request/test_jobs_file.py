"""Jobs files: tables become jobs, and what a file says wrong is told with its key."""

import math

from jobs_files import (
    FIXED,
    Machine,
    Outputs,
    Reading,
    jobs,
    jobs_file,
    lens_values,
    names,
    read_batch,
    touch,
)


def test_every_table_reaches_the_job(tmp_path):
    text = """
[reading]
depth-unit = "cm"
depth-channel = "Z"
color-layer = "beauty"
part = 1
depth-repair = "off"
[outputs]
kinds = ["render", "coc"]
format = "jpeg"
preview = true
[machine]
quality = "high"
"""
    outputs = Outputs(tmp_path / "o", overwrite=True)
    machine = Machine(device="cpu", threads=3)
    (job,) = read_batch(jobs_file(tmp_path, FIXED + text), outputs, machine).jobs
    assert job.lens == lens_values()
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
    job = read_batch(jobs_file(tmp_path, FIXED), outputs, machine).jobs[0]
    assert (job.outputs, job.machine, job.reading) == (outputs, machine, Reading())
    assert job.sample_id == "a"


def test_a_lens_file_lies_below_the_options_of_the_jobs_file(tmp_path):
    (tmp_path / "l.toml").write_text('focal-length = "85mm"\nfnumber = 2\nfocus = inf\n')
    text = '[lens]\nfile = "l.toml"\nfnumber = 4\n'
    assert jobs(tmp_path, text)[0].lens == lens_values(85.0, 4.0, math.inf)
    text = '[lens]\nfile = "l.toml"\n[sweep]\nfocus = ["2m"]\n'
    assert jobs(tmp_path, text)[0].lens == lens_values(85.0, 2.0, 2000.0)


def test_all_lenses_of_a_picture_follow_one_another(tmp_path):
    touch(tmp_path, "1.exr", "2.exr")
    found = jobs(tmp_path, FIXED + "[sweep]\nblades = [0, 5]\n", inputs='color = "*.exr"')
    assert names(found) == ["1_blades0", "1_blades5", "2_blades0", "2_blades5"]
