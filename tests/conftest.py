"""Paths, threads, and the two input files that tests of the command line share."""

import signal
import sys
from contextlib import chdir
from pathlib import Path

import pytest
import torch
from command_line import color_exr, depth_exr, pair
from renderers import HAS_LOOPS
from skips import pytest_sessionfinish, pytest_terminal_summary  # noqa: F401 - hooks

from defocus_core.batch.run_batch import WorkerConfig
from defocus_core.batch.workers import pipeline

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_scenes"))

# Small tensors gain nothing from a second thread, and lose much where the machine is busy.
torch.set_num_threads(1)
# A shell lets what runs in the background ignore Ctrl-C, and nohup the end of a session: the
# processes that are to be interrupted here would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_sessionstart():
    """Compile what is to be compiled before tests look at what is said, and how long it takes."""
    if HAS_LOOPS:
        from defocus_core.renderer.compiled.once import compile_once

        compile_once()


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture
def here(tmp_path):
    """The folder of the test, in which its commands run."""
    with chdir(tmp_path):
        yield tmp_path


@pytest.fixture
def color(tmp_path):
    return color_exr(tmp_path / "color.exr")


@pytest.fixture
def depth(tmp_path):
    return depth_exr(tmp_path / "depth.exr")


@pytest.fixture
def folders(tmp_path):
    """Directories of three pictures."""
    for stem in "abc":
        color, depth = pair(tmp_path, stem)
    return color.parent, depth.parent


EXECUTE = WorkerConfig.execute


@pytest.fixture(autouse=True, scope="session")
def machine():
    """Local batches in this process: another takes 2 s to import torch."""
    with pytest.MonkeyPatch.context() as patch:
        here = lambda c: pipeline.execute if c.scheduler == "local" else EXECUTE(c)  # noqa: E731
        patch.setattr(WorkerConfig, "execute", here)
        yield


@pytest.fixture
def in_processes(monkeypatch):
    """From this call on, local batches are done in processes of their own."""
    return lambda: monkeypatch.setattr(WorkerConfig, "execute", EXECUTE)


@pytest.fixture
def torch_back(monkeypatch):
    """Render by torch, also what the compiled back carries."""
    monkeypatch.setattr("defocus_core.renderer.compiled.carried.available", lambda: False)
