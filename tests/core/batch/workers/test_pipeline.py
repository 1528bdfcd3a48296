"""Reading, rendering and writing overlap, within bounds."""

import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from jobs_files import job_of

from defocus_core.batch.journal.record import Failed
from defocus_core.batch.workers import pipeline
from defocus_core.picture import plain_path

STEP = 0.03  # seconds


class Steps:
    """Stands for the steps of jobs, and notes when they begin and end."""

    def __init__(self):
        self.events: list[tuple[str, str]] = []
        self.fails: tuple[str, str] = ("", "")
        self.interrupted: tuple[str, str] = ("", "")
        self.waits = threading.get_ident()
        self.meanwhile: dict[tuple[str, str], set[tuple[str, str]]] = {}

    def step(self, name, job):
        self.events.append((f"{name}", job.sample_id))
        if self.interrupted == (name, job.sample_id):  # Ctrl-C, at the thread that waits
            signal.pthread_kill(self.waits, signal.SIGINT)
        time.sleep(STEP)
        while not self.meanwhile.get((name, job.sample_id), set()) <= {*self.events}:
            time.sleep(STEP)
        self.events.append((f"{name}.", job.sample_id))

    def read(self, job):
        self.step("read", job)
        failed = Failed("failed", "fault", "as asked")
        return failed if self.fails == ("read", job.sample_id) else SimpleNamespace(stamps={})

    def compute(self, job, progress=None):
        self.step("compute", job)
        if self.fails == ("compute", job.sample_id):
            raise ValueError("as asked")
        return SimpleNamespace(sample_id=job.sample_id, bound_mb=0.0)

    def write(self, made):
        if isinstance(made, Failed):
            return made
        self.step("write", made)
        return SimpleNamespace(status="ok")

    def at(self, event, name):
        return self.events.index((event, name))


@pytest.fixture
def steps(monkeypatch):
    made = Steps()
    monkeypatch.setattr(pipeline, "Reader", lambda: made)
    monkeypatch.setattr(plain_path, "prepare", lambda job, inputs: job)
    monkeypatch.setattr(plain_path, "compute", made.compute)
    monkeypatch.setattr(pipeline, "write", made.write)
    return made


def jobs(names):
    for number, name in enumerate(names):
        yield number, job_of(Path(name), Path(name), Path("out"), name=name)


def test_the_next_is_read_and_the_last_is_written_while_one_is_computed(steps):
    """Each waits for those two: the run would else never end."""
    for before, now, after in ("abc", "bcd", "cde", "def"):
        steps.meanwhile["compute", now] = {("read", after), ("write", before)}
    done = []
    pipeline.run(jobs("abcdefgh"), lambda number, result: done.append(number))
    assert done == list(range(8))


def test_one_picture_waits_at_most_before_and_behind(steps):
    pipeline.run(jobs("abcdefgh"), lambda number, result: None)
    for before, now, after in ("abc", "bcd", "cde", "def", "efg", "fgh"):
        assert steps.at("read", after) > steps.at("read.", now)
        assert steps.at("read", after) > steps.at("compute", before) - 1
        assert steps.at("compute.", after) > steps.at("write.", before)


def test_one_job_is_a_call_without_threads(steps, monkeypatch):
    monkeypatch.setattr(plain_path, "load", lambda: None)
    monkeypatch.setattr(threading.Thread, "start", None)
    done = []
    pipeline.execute(iter([[*jobs("a")]]), lambda number, _: done.append(number), lambda: False)
    assert done == [0]
    in_order = ["read", "read.", "compute", "compute.", "write", "write."]
    assert [event for event, _ in steps.events] == in_order


@pytest.mark.parametrize("step", ["read", "compute"])
def test_what_fails_skips_the_steps_that_follow(step, steps):
    steps.fails = (step, "b")
    done = {}
    pipeline.run(jobs("abc"), lambda number, result: done.update({number: result.status}))
    assert done == {0: "ok", 1: "failed", 2: "ok"}
    assert ("write", "b") not in steps.events


def test_what_done_raises_ends_the_run(steps):
    def done(number, result):
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        pipeline.run(jobs("abcdefgh"), done)
    assert ("compute", "g") not in steps.events


def test_what_the_jobs_raise_ends_the_run_after_those_before(steps):
    def broken():
        yield from jobs("ab")
        raise OSError("no note can be made")

    done = []
    with pytest.raises(OSError, match="note"):
        pipeline.run(broken(), lambda number, result: done.append(number))
    assert done == [0, 1]
    assert threading.active_count() < 20


def test_what_was_read_ahead_when_it_is_stopped_is_let_go(steps):
    done = []

    def stopped():  # asked before b is computed: a is written, c is read
        return ("compute.", "a") in steps.events

    pipeline.run(jobs("abcdefgh"), lambda number, result: done.append(number), stopped=stopped)
    assert done == [0]
    assert ("compute", "b") not in steps.events
    assert ("read", "d") not in steps.events


def test_ctrl_c_during_the_last_write_comes_after_it(steps):
    done = []
    steps.interrupted = ("write", "a")
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(jobs("a"), lambda number, result: done.append(number))
    assert done == [0]


def test_what_is_being_decoded_ends_before_the_run_does(steps):
    steps.interrupted = ("read", "b")  # while a is computed
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(jobs("abc"), lambda number, result: None)
    begun = {name for event, name in steps.events if event == "read"}
    assert begun == {name for event, name in steps.events if event == "read."}


def test_jobs_of_one_picture_are_decoded_once(tmp_path, monkeypatch):
    from defocus_core.picture.take import Inputs

    decoded = []

    def load(job):
        decoded.append(job.picture.stem)
        return Inputs(*[None] * 3)

    monkeypatch.setattr(plain_path, "read", load)
    reader = pipeline.Reader()
    for name in "aaabba":
        reader.read(job_of(tmp_path / name, tmp_path / name, tmp_path, name=name))
    assert decoded == ["a", "b", "a"]
