"""What is said of a picture that does not fit into the memory of the machine."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import pair
from jobs_files import Machine, job_of

from defocus_core.errors import TooLarge
from defocus_core.picture import memory_budget
from defocus_core.renderer.engine import memory_bound
from defocus_core.system import memory


@pytest.fixture
def short(tmp_path, monkeypatch):
    """A job for four threads on a machine that has 100 MB left, and what its rendering needs."""

    def made(bound, limit=None):
        memory_budget.limit_mb(Machine())  # kept for the tests that come later
        monkeypatch.setattr(memory, "available_mb", lambda device="cpu": 100.0)
        monkeypatch.setattr(memory_bound, "memory_bound", lambda _, threads: 1e6 * bound(threads))
        machine = {"threads": 4, "memory": limit}
        return job_of(*pair(tmp_path), tmp_path / "out", machine=machine)

    return made


def bound_of(job, room_mb=None):
    """The bound in MB beside arrays of 10 MB, by a limit that leaves some room."""
    if room_mb is not None:
        limit = int(memory.MB * (memory_budget.base_mb() + 10 + room_mb))
        job = replace(job, machine=replace(job.machine, memory=limit))
    renderer: Any = SimpleNamespace(with_tile=lambda tile: tile)
    return memory_budget.bound_of(job, renderer, 10.0, "cpu")


@pytest.mark.parametrize(
    ("of_one_thread", "remedy"), [(90.0, "use ‹threads› 1"), (800.0, "smaller picture")]
)
def test_what_does_not_fit_is_refused_with_what_would_help(of_one_thread, remedy, short):
    job = short(lambda threads: of_one_thread if threads == 1 else 450.0)
    with pytest.raises(TooLarge, match=remedy):
        bound_of(job)


def test_a_smaller_tile_is_proposed_if_that_is_enough(short, monkeypatch):
    job = short(lambda threads: 90.0)
    monkeypatch.setattr(memory_bound, "memory_bound", lambda tile, *_: 1e6 * (tile or 1000) / 3)
    with pytest.raises(TooLarge, match="use ‹threads› 1 ‹tile› 256"):
        bound_of(job, 90.0)


def test_what_a_limit_forbids_a_greater_one_would_allow(short, monkeypatch):
    job = short(lambda threads: 60.0, limit=500 * memory.MB)
    monkeypatch.setattr(memory, "available_mb", lambda device="cpu": 4000.0)
    with pytest.raises(TooLarge, match=r"use ‹memory› \d+MB") as refusal:
        bound_of(job, 30.0)
    said = int(re.findall(r"\d+", str(refusal.value))[-1])
    assert 70 < said - memory_budget.base_mb() < 90, "10 of files, and 60"
