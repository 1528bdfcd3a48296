"""Large pictures are rendered by two processes: the same files, whatever becomes of the second."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batches import contents
from command_line import Ran, color_exr, depth_exr, run

from defocus_cli import helper
from defocus_core import tiling
from defocus_core.scenery import scenery

pytestmark = pytest.mark.skipif(not helper.can_help(), reason="this system copies no processes")
LENS = ("--focal-length", "85mm", "--fnumber", "1.4", "--focus", "2m")
SIZE = (120, 200)
FAR = 85 / 1.4 / 2 * 85 / (2000 - 85) / (36 / SIZE[1])  # px, the radius of what is infinitely far


@pytest.fixture
def frame(tmp_path: Path) -> list[Path]:
    scene = scenery("cards", *SIZE, 5.0)
    depth = 2.0 / (1.0 - scene.signed_radius / FAR)
    pixels = scene.image.permute(1, 2, 0).numpy()
    return [color_exr(tmp_path / "rgb.exr", pixels), depth_exr(tmp_path / "z.exr", depth.numpy())]


@pytest.fixture(autouse=True)
def small_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(helper, "_HELPED", 0)
    monkeypatch.setattr(helper, "_HELPED_OF_TWO", 0)
    monkeypatch.setattr(tiling, "_REGION", 64)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The helpers that were begun."""
    found: list[int] = []
    fork = os.fork

    def spy() -> int:
        if process := fork():
            found.append(process)
        return process

    monkeypatch.setattr(os, "fork", spy)
    return found


def render(frame: list[Path], out: Path, threads: int, *more: object) -> Ran:
    return run("render", *frame, "-o", out, *LENS, "--threads", threads, *map(str, more))


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize(
    "more",
    [
        (),
        ("--quality", "draft"),
        ("--tile", 16, "--outputs", "render,left,right,coc,trust"),
        ("--quality", "draft", "--tile", 16, "--format", "png16"),
    ],
)
def test_a_helper_changes_no_byte(
    frame: list[Path], tmp_path: Path, begun: list[int], more: tuple[object, ...], threads: int
) -> None:
    assert render(frame, tmp_path / "one", 1, *more).code == 0
    assert not begun
    ran = render(frame, tmp_path / "two", threads, *more, "--json")
    assert len(begun) == 1
    assert contents(tmp_path / "two") == contents(tmp_path / "one")
    job = ran.json["pictures"][0]
    assert job["warnings"] == []
    assert job["render_cpu_seconds"] > 0


def test_what_lies_behind_is_known_to_both(
    frame: list[Path], tmp_path: Path, begun: list[int]
) -> None:
    for threads in (1, 2):
        ran = render(frame, tmp_path / str(threads), threads, "--hidden", *frame)
        assert ran.code == 0, ran.err
    assert len(begun) == 1
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_statistics_and_progress_are_of_both(
    frame: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, int]] = []
    from defocus_cli import engine

    rendered = engine.rendered
    monkeypatch.setattr(
        engine, "rendered", lambda *args: rendered(*args[:3], lambda *count: told.append(count))
    )
    stats = []
    for threads in (1, 2):
        told.clear()
        ran = render(frame, tmp_path / str(threads), threads, "--stats", "--json", "--tile", 16)
        stats.append(ran.json["pictures"][0]["stats"])
        tiles = told[0][1]
        assert told == [(count, tiles) for count in range(1, tiles + 1)]
    assert stats[0] == stats[1]


@pytest.mark.parametrize("more", [(), ("--quality", "draft", "--tile", 16)])
def test_a_helper_that_is_killed_is_done_without_and_said_so(
    frame: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    more: tuple[object, ...],
) -> None:
    assert render(frame, tmp_path / "one", 1, *more).code == 0
    monkeypatch.setattr(helper, "_help", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
    ran = render(frame, tmp_path / "two", 2, *more)
    assert ran.code == 0
    assert "the process that helps was ended by SIGKILL" in ran.err
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_system_without_room_for_processes_renders_alone_and_says_so(
    frame: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> int:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", none)
    ran = render(frame, tmp_path / "out", 2)
    assert ran.code == 0
    assert "could not begin: Resource temporarily unavailable" in ran.err


def test_where_memory_is_short_threads_do_it(
    frame: list[Path], tmp_path: Path, begun: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    from defocus_cli import sizing

    render(frame, tmp_path / "one", 1)
    monkeypatch.setattr(sizing, "fits_anyhow", lambda *_, **__: False)
    monkeypatch.setattr(sizing, "room_on", lambda *_: 1e6)
    assert render(frame, tmp_path / "two", 2).code == 0
    assert len(begun) == 1
    least = []

    def room(*_: object) -> float:
        return least[0]

    predicted = sizing.Calibration.predicted_mb

    def spy(*args: object, helped: bool = False) -> float:
        found = predicted(*args, helped=helped)  # type: ignore[arg-type]
        least[:] = [found * 0.999] if helped else least
        return found

    least.append(1e6)
    monkeypatch.setattr(sizing.Calibration, "predicted_mb", spy)
    render(frame, tmp_path / "three", 2)
    monkeypatch.setattr(sizing, "room_on", room)
    assert render(frame, tmp_path / "four", 2).code == 0
    assert len(begun) == 2
    for name in ("two", "three", "four"):
        assert contents(tmp_path / name) == contents(tmp_path / "one")


SLOWLY = """
import os, sys, time
from defocus_cli import helper, sharing
helper._HELPED_OF_TWO = 0
done = sharing.Member._done
def slowly(self, work, piece):
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(1.5)
    return done(self, work, piece)
sharing.Member._done = slowly
from defocus_cli.__main__ import run
run()
"""


def processes_of(group: int) -> list[int]:
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                told = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(told[2]) == group and told[0] != "Z":
                found.append(int(folder.name))
    return found


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_helper_outlives_its_command(frame: list[Path], tmp_path: Path, end: int) -> None:
    words = ["render", *frame, "-o", tmp_path / "out", *LENS, "--threads", "2", "--tile", "16"]
    command = subprocess.Popen(
        [sys.executable, "-c", SLOWLY, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert command.stdout is not None
    seen = {int(command.stdout.readline()) for _ in range(2)}
    assert len(seen) == 2
    assert set(processes_of(command.pid)) == seen
    command.send_signal(end)
    if end == signal.SIGINT:  # once more is at once
        time.sleep(0.3)
        command.send_signal(end)
    _, told = command.communicate(timeout=60)
    assert "Traceback" not in told
    limit = time.monotonic() + 20
    while (left := processes_of(command.pid)) and time.monotonic() < limit:
        time.sleep(0.05)
    assert left == []
    assert not list((tmp_path / "out").glob("render/*"))


def test_a_forecast_counts_the_memory_of_both(frame: list[Path], tmp_path: Path) -> None:
    def peak(threads: int) -> float:
        ran = render(frame, tmp_path / "out", threads, "--dry-run", "--json")
        return float(ran.json["forecast"]["peak_mb"])

    assert peak(2) > peak(1)
