"""Jobs files for the tests, and what is read from them."""

import numpy as np
from command_line import color_exr, depth_exr, ramp

from defocus_core.errors import CALLER
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading
from defocus_core.request.jobs_file import read_batch
from defocus_core.request.lens import LensValues
from defocus_core.request.resolver import parsed

# Types of jobs, which tests take from here.
__all__ = ["Job", "LensValues", "Machine", "Outputs", "PictureFiles", "Reading", "read_batch"]

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


def jobs_of(path, out):
    """The jobs of a jobs file that write to a folder."""
    return read_batch(path, Outputs(out), Machine()).jobs


def jobs(folder, text, *, inputs="", out="out"):
    return jobs_of(jobs_file(folder, text, inputs=inputs), folder / out)


def names(found):
    return [job.sample_id for job in found]


def pictures(folder):
    for name, nearer in (("a", 1.0), ("b", 2.0)):
        color_exr(folder / f"{name}_rgb.exr")
        depth_exr(folder / f"{name}_z.exr", ramp() * np.float32(nearer))


def lens_values(foclen=50.0, fnum=2.0, foc_dist=2000.0, **look):
    """A lens of 50 mm at f/2, focused at 2 m, unless told otherwise."""
    return LensValues(foclen, fnum, foc_dist, **look)


def option(name, text):
    """The value of an option of the caller's."""
    return parsed(name, text, CALLER.with_field(name))


def job_of(color, depth, out, *, name="a", machine=None, **lens):
    """A job of one picture by a lens of 50 mm at f/2, focused at 2 m."""
    picture, values = PictureFiles(name, color, depth), lens_values(**lens)
    return Job(picture, values, Reading(), Outputs(out), Machine(**machine or {}))


def chunks_of(folder, *names, size=1):
    jobs = [job_of(folder / n, folder / n, folder, name=n) for n in names]
    numbered = list(enumerate(jobs))
    return (numbered[i : i + size] for i in range(0, len(numbered), size))
