"""What batches cost: no more memory for more jobs."""

import subprocess
import sys

import pytest
from batches import JOBS
from command_line import pair

pytestmark = pytest.mark.bench


def test_memory_does_not_grow_with_the_jobs(tmp_path):
    pair(tmp_path)
    text = JOBS.replace('["1.5m", "2m"]', '"1.5m..3m @ 2000 in depth"').replace('"coc"', '"render"')
    (tmp_path / "jobs.toml").write_text(text)
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
