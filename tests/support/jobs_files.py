"""Jobs files for the tests, and what is read from them."""

import numpy as np
from command_line import color_exr, depth_exr, ramp

from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading
from defocus_core.request.jobs_file import read_batch
from defocus_core.request.lens import LensValues

LENS = '[lens]\nfocal-length = "50mm"\n'
FIXED = LENS + 'fnumber = 2\nfocus = "2m"\n'

INPUTS = 'color = "*_rgb.exr"\ndepth = "*_z.exr"'
SAMPLE = """
[sample]
n = 4
seed = 7
fnumber = "loguniform(1.4, 16)"
focus = "percentile(5, 95)"
[outputs]
kinds = ["render", "coc"]
"""


def touch(folder, *names):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def jobs_file(folder, text, *, inputs=""):
    """A jobs file for one picture, unless ``inputs`` says otherwise."""
    if not inputs:
        inputs = 'color = "a.exr"'
        touch(folder, "a.exr")
    path = folder / "jobs.toml"
    path.write_text(f"[inputs]\n{inputs}\n{text}")
    return path


def jobs(folder, text, *, inputs="", out="out"):
    path = jobs_file(folder, text, inputs=inputs)
    return read_batch(path, Outputs(folder / out), Machine()).jobs


def names(found):
    return [job.sample_id for job in found]


def pictures(folder):
    for name, nearer in (("a", 1.0), ("b", 2.0)):
        color_exr(folder / f"{name}_rgb.exr")
        depth_exr(folder / f"{name}_z.exr", ramp() * np.float32(nearer))


def chunks_of(folder, *names, size=1):
    jobs = [
        Job(
            PictureFiles(n, folder / n, folder / n),
            LensValues(50.0, 2.0, 2000.0),
            Reading(),
            Outputs(folder),
            Machine(),
        )
        for n in names
    ]
    numbered = list(enumerate(jobs))
    return (numbered[i : i + size] for i in range(0, len(numbered), size))
