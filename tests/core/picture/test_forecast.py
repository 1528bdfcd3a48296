"""Forecasts: the rate of this machine, and the time of twelve kinds of job."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import depth_exr

from defocus_core import read_color, read_depth, write_image
from defocus_core.picture import forecast, plain_path
from defocus_core.picture.forecast import work_per_second  # before tests replace it
from defocus_core.request.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.request.lens import Lens

SCENE = Path(__file__).parents[3] / "sample_scenes" / "spheres"
LENS = Lens(75.0, 1.4, 1600.0, sensor_width=54.0)
PHOTO = Outputs(Path(), format="png", preview=True)
ALL = ("render", "left", "right", "coc")
KINDS = {
    "an EXR": {},
    "high": {"machine": Machine(quality="high")},
    "PNG with previews": {"outputs": PHOTO},
    "16 bits": {"outputs": Outputs(Path(), format="png16")},
    "dual pixel": {"outputs": Outputs(Path(), kinds=ALL)},
    "dual pixel as PNG": {"outputs": replace(PHOTO, kinds=ALL)},
    "maps alone": {"outputs": Outputs(Path(), kinds=("coc", "disparity"))},
    "soft depth": {"soft": True},
    "lights": {"lens": replace(LENS, highlights=(0.9, 16.0)), "clipped": True},
    "a cat's eye of blades": {"lens": replace(LENS, blades=6, cat_eye=(1.05, 1.5))},
    "axial colour": {"lens": replace(LENS, axial_color=(0.1, 0.1))},
}


def job_of(
    folder,
    *,
    soft=False,
    clipped=False,
    lens=LENS,
    outputs=Outputs(Path()),  # noqa: B008
    machine=Machine(),  # noqa: B008
):
    depth = SCENE / "depth.exr"
    if soft:  # edges as wide as estimated ones
        metres = read_depth(depth).metres
        wide = sum(np.roll(1 / metres, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1))
        depth = depth_exr(folder / "soft.exr", (9 / wide).astype(np.float32))
    color = SCENE / "rgb.exr"
    if clipped:
        write_image(folder / "clipped.png", 4 * read_color(color).pixels)
        color = folder / "clipped.png"
    picture = Picture("a", color, depth)
    return Job(picture, lens, Reading(), replace(outputs, root=folder), machine)


def test_a_measurement_renders_a_picture(monkeypatch):
    monkeypatch.setattr(forecast, "SCENE", ("cards", 48, 64, 3.0))
    work_per_second.cache_clear()
    assert 1e5 < work_per_second("cpu", 1) < 1e12
    work_per_second.cache_clear()


@pytest.mark.bench
def test_twelve_kinds_of_job_take_what_is_foreseen(tmp_path, monkeypatch):
    monkeypatch.setattr(forecast, "work_per_second", work_per_second)
    factors = {}
    for name, options in KINDS.items():
        job = job_of(tmp_path, **options)
        by_number, errors = forecast.forecasts([job])
        assert not errors, (name, errors)
        expected = by_number[0].seconds
        start = time.perf_counter()
        plain_path.write(plain_path.compute(job, plain_path.read(job)))
        took = time.perf_counter() - start
        factors[name] = expected / took
        print(  # noqa: T201
            f"{name:22} foreseen {expected:5.2f} s, took {took:5.2f} s: {factors[name]:.2f}"
        )
        for file in job.written:
            file.unlink()
    assert not {n: f for n, f in factors.items() if not 0.5 < f < 2}
