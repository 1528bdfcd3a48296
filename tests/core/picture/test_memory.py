"""``--memory`` bounds what a process holds, ``--tile`` sets the grid; neither changes a picture."""

import threading

import pytest
import torch
from command_line import color_exr, depth_exr, pair, ramp, refused, render, texture
from jobs_files import job_of
from refusals import refuses

from defocus_core.batch import run_batch
from defocus_core.picture import memory_budget, plain_path
from defocus_core.renderer.engine import renderer
from defocus_core.system import memory

SIZE = (70, 90)


def frames(tmp_path, size=SIZE):
    color = color_exr(tmp_path / "c.exr", texture(*size))
    return color, depth_exr(tmp_path / "z.exr", ramp(*size))


def job(tmp_path, limit, size=SIZE):
    files = frames(tmp_path, size)
    return job_of(*files, tmp_path / "out", name="c", machine={"memory": limit})


def beyond_base(mb):
    """A limit of so many MB beyond what the program takes."""
    return int((memory_budget.base_mb() + mb) * memory.MB)


def test_what_does_not_fit_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    asked = job(tmp_path, beyond_base(5), (700, 900))
    monkeypatch.setattr(plain_path, "read_pair", None)
    with refuses("out-of-memory", "‹memory›", path=asked.picture.color):
        plain_path.read(asked)


def test_too_little_memory_is_refused_with_how_much_would_do(tmp_path):
    args = (*frames(tmp_path), "-o", tmp_path / "out")
    ran = render(*args, "--memory", "20MB", "--threads", "1")
    refused(ran, 3, "out-of-memory", "c.exr")
    dry = render(*args, "--memory", "20MB", "--threads", "1", "--dry-run")
    assert (dry.code, dry.err) == (3, ran.err), "a dry run says so, too"
    enough = ran.err.strip().rpartition(" ")[2]
    assert render(*args, "--memory", enough, "--threads", "1").code == 0


@pytest.fixture
def gated(tmp_path):
    """A gate behind which one picture is, whether another one came in, and room for two or not."""

    def entered(pictures):
        arrays = memory_budget.arrays_mb(job(tmp_path, 2**33))
        asked = job(tmp_path, beyond_base(arrays * pictures))
        gate, came = memory_budget.Gate(), threading.Event()
        gate.enter(0, asked)
        second = threading.Thread(target=lambda: (gate.enter(1, asked), came.set()), daemon=True)
        second.start()
        return gate, came, arrays

    return entered


def came_soon(came):
    return came.wait(0.05)


def test_pictures_that_fit_beside_what_renders_one_are_let_in(gated):
    gate, came, arrays = gated(5.1)
    assert not came_soon(came), "nobody knows what rendering takes"
    gate.rendered(0, 3 * arrays)
    assert came.wait()


def test_others_wait_until_there_is_room(gated):
    gate, came, arrays = gated(4.9)
    gate.rendered(0, 3 * arrays)
    assert not came_soon(came)
    gate.leave(0)
    assert came.wait()


def test_nobody_waits_at_an_open_gate(gated):
    gate, came, _ = gated(1.5)
    assert not came_soon(came)
    gate.open()
    assert came.wait()


def test_tile_sets_the_grid(tmp_path):
    args = (*frames(tmp_path), "--json")
    (usual,) = render(*args, "-o", tmp_path / "a").json["pictures"]
    (small,) = render(*args, "-o", tmp_path / "b", "--tile", "32").json["pictures"]
    assert (usual["stats"]["tiles"], small["stats"]["tiles"]) == (1, 9)
    (again,) = render(*args, "-o", tmp_path / "b").json["pictures"]
    assert not again["done_before"], "other tiles make other last digits"


def test_where_no_region_fits_a_gpu_the_picture_is_refused(tmp_path, monkeypatch):
    def tiles(self, progress=None):
        raise torch.OutOfMemoryError

    monkeypatch.setattr(renderer.Renderer, "tiles", tiles)
    ran = render(*pair(tmp_path), "-o", tmp_path / "out", "--quality", "high")
    refused(ran, 3, "out-of-memory", "a.exr")


def test_processes_share_the_memory_unless_told(monkeypatch):
    monkeypatch.setattr(memory, "available_mb", lambda: 1000.0)
    shared = run_batch.WorkerConfig("local", 4, 1, "cpu", None, None).machine.memory
    assert shared == int(0.8 * 1000 / 4 * memory.MB)
    assert run_batch.WorkerConfig("local", 4, 1, "cpu", 7, None).machine.memory == 7
    assert run_batch.WorkerConfig("local", 1, 1, "cpu", None, None).machine.memory is None


@pytest.mark.parametrize(
    ("available", "threads", "processes", "shared_out"),
    [
        (64000.0, None, None, (8, 1)),
        (9000.0, None, None, (4, 2)),
        (11000.0, None, None, (5, 1)),
        (500.0, None, None, (1, 8)),
        (None, None, None, (8, 1)),
        (500.0, 2, None, (4, 2)),
        (500.0, None, 8, (8, 1)),
        (64000.0, 16, None, (1, 16)),
    ],
)
def test_each_core_has_a_process_if_there_is_memory_for_it(
    monkeypatch, available, threads, processes, shared_out
):
    free = iter([available])
    monkeypatch.setattr(memory, "available_mb", lambda: next(free, 0.0))
    monkeypatch.setattr(run_batch, "cores", lambda: 8)
    crew = run_batch.WorkerConfig("local", processes, threads, "cpu", 7, None)
    assert (crew.count, crew.machine.threads) == shared_out
    assert crew.count == shared_out[0], "whatever is free by now"
