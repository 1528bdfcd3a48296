"""Jobs files for the tests, and what is read from them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from command_line import color_exr, depth_exr, ramp

from defocus_core.batch.jobs.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.batch.jobs.jobs_file import read_jobs
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.workers.plan import Chunk

LENS = '[lens]\nfocal-length = "50mm"\n'
FIXED = LENS + 'fnumber = 2\nfocus = "2m"\n'

INPUTS = 'color = "*_rgb.exr"\ndepth = "*_z.exr"'
SAMPLE = """
[sample]
n = 4
seed = 7
fnumber = "loguniform(1.4, 16)"
focus = "percentile(5, 95)"
max-coc = "0.3px"
[outputs]
kinds = ["render", "coc"]
"""


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def jobs_file(folder: Path, text: str, *, inputs: str = "") -> Path:
    """A jobs file for one picture, unless ``inputs`` says otherwise."""
    if not inputs:
        inputs = 'color = "a.exr"'
        touch(folder, "a.exr")
    path = folder / "jobs.toml"
    path.write_text(f"[inputs]\n{inputs}\n{text}")
    return path


def jobs(folder: Path, text: str, *, inputs: str = "", out: str = "out") -> list[Job]:
    path = jobs_file(folder, text, inputs=inputs)
    return read_jobs(path, Outputs(folder / out), Machine())


def names(found: list[Job]) -> list[str]:
    return [job.sample_id for job in found]


def pictures(folder: Path) -> None:
    for name, nearer in (("a", 1.0), ("b", 2.0)):
        color_exr(folder / f"{name}_rgb.exr")
        depth_exr(folder / f"{name}_z.exr", ramp() * np.float32(nearer))


def chunks_of(folder: Path, *names: str, size: int = 1) -> Iterator[Chunk]:
    jobs = [
        Job(
            Picture(n, folder / n, folder / n),
            Lens(50.0, 2.0, 2000.0),
            Reading(),
            Outputs(folder),
            Machine(),
        )
        for n in names
    ]
    numbered = list(enumerate(jobs))
    return (numbered[i : i + size] for i in range(0, len(numbered), size))
