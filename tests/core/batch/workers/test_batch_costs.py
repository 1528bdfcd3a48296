"""What batches cost: five lenses less than five, rendering and little else, no more memory."""

import os
import resource
import subprocess
import sys
from datetime import datetime

import numpy as np
import pytest
from batches import JOBS, records
from command_line import color_exr, depth_exr, pair, texture

pytestmark = pytest.mark.bench
WIDTH, HEIGHT = 1920, 1080


def scene(folder, stem, seed):
    """A picture of patches with some noise; a card before a floor, and sky."""
    patches = np.kron(texture(48, 27, seed), np.ones((40, 40, 1), np.float32))
    color_exr(folder / "rgb" / f"{stem}.exr", patches * (0.9 + 0.1 * texture(WIDTH, HEIGHT, seed)))
    metres = np.tile(np.linspace(1, 4, WIDTH, dtype=np.float32), (HEIGHT, 1))
    metres[270:540, 480:960] = 0.8
    metres[:135] = np.inf
    depth_exr(folder / "depth" / f"{stem}.exr", metres)


def jobs_of(folder, focus):
    """Write a jobs file that renders each picture at some distances."""
    text = JOBS.replace('["1.5m", "2m"]', focus).replace('"coc"', '"render"')
    (folder / "jobs.toml").write_text(text)


def batch(folder, focus, out, *args):
    """CPU seconds of a batch on one process."""
    jobs_of(folder, focus)
    words = [sys.executable, "-m", "defocus_cli", "batch", folder / "jobs.toml", "-o", out]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*words, "--processes", "1", *args], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("threads", ["1", "2"])
def test_five_lenses_cost_at_most_four_times_one(tmp_path, threads):
    scene(tmp_path, "a", 0)
    one = batch(tmp_path, '["2m"]', tmp_path / "one", "--threads", threads)
    five = batch(tmp_path, '"1.5m..3m @ 5"', tmp_path / "five", "--threads", threads)
    assert five < 4 * one


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="not on this system: one core")
def test_rendering_is_busy(tmp_path):
    for number in range(16):
        scene(tmp_path, f"{number:02}", number)
    batch(tmp_path, '["2m"]', tmp_path / "out", "--threads", "1")
    first, *rest = records(tmp_path / "out")
    begun, ended = (datetime.fromisoformat(one["finished"]) for one in (first, rest[-1]))
    busy = sum(one["seconds"]["render"] for one in rest)
    assert busy >= 0.9 * (ended - begun).total_seconds()


def test_memory_does_not_grow_with_the_jobs(tmp_path):
    pair(tmp_path)
    jobs_of(tmp_path, '"1.5m..3m @ 2000 in depth"')
    script = (
        "import itertools, resource, sys; from defocus_core import run_batch\n"
        "count = itertools.count(1)\n"
        "def ended(job, record):\n"
        "    if next(count) in (500, 2000):\n"
        "        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
        "run_batch(*sys.argv[1:], ended=ended)"
    )
    words = [sys.executable, "-c", script, tmp_path / "jobs.toml", tmp_path / "out"]
    ran = subprocess.run(words, check=True, capture_output=True, text=True)
    early, late = map(int, ran.stdout.split())
    assert late < 1.02 * early
