"""What this machine takes for a unit of work: measured once, kept, measured anew if need be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from defocus_cli import calibration, memory
from defocus_cli.calibration import Calibration, calibrated, keep, kept
from defocus_core.mending import Mending
from defocus_core.planning import BYTES, LOADS, Plan, plan
from defocus_core.scenery import scenery

MADE = Calibration(dict.fromkeys(LOADS, 1.0), dict.fromkeys(BYTES, 1.0), 1)


def test_usual_are_all_that_a_plan_counts() -> None:
    assert set(calibration._USUAL_SECONDS) == set(LOADS)
    assert set(calibration._USUAL_BYTES) == set(BYTES)


def planned(
    tiles: int = 6, regions: int = 1, *, busy: int | None = None, alone: bool = False
) -> Plan:
    """Of one unit of work: for the tiles, or for the regions alone."""
    nothing = dict.fromkeys(LOADS, 0.0)
    work = nothing | {"products": 1.0}
    of_regions = (work if alone else nothing) | {"regions": float(busy or regions)}
    held = dict.fromkeys(BYTES, float(memory.MB))
    of_tiles = nothing if alone else work
    counts = (3, tiles, regions, 6 * tiles, tiles, 0)
    return Plan(*counts, nothing, of_regions, of_tiles, held, 0.0, Mending())


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "defocus"


def test_what_was_measured_is_kept_and_measured_no_more(
    cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibration, "measured", lambda device, threads: MADE)
    assert kept("cpu", 1) is None
    assert calibrated("cpu", 1) == MADE
    assert str(cache) in capsys.readouterr().err
    assert [file.name for file in cache.iterdir()] == ["calibration-cpu-1.json"]
    monkeypatch.setattr(calibration, "measured", None)
    assert calibrated("cpu", 1) == kept("cpu", 1) == MADE
    assert capsys.readouterr().err == ""
    assert kept("cpu", 2) is None


def test_another_renderer_is_measured_anew(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(MADE, "cpu")
    monkeypatch.setattr(calibration, "_core", lambda: "another")
    assert kept("cpu", 1) is None


@pytest.mark.parametrize("text", ["", "{", "[]", '{"key": 1}'])
def test_a_damaged_file_is_measured_anew(cache: Path, text: str) -> None:
    keep(MADE, "cpu")
    (file,) = cache.iterdir()
    file.write_text(text)
    assert kept("cpu", 1) is None


def test_coefficients_that_are_none_are_measured_anew(cache: Path) -> None:
    keep(MADE, "cpu")
    (file,) = cache.iterdir()
    file.write_text(json.dumps({**json.loads(file.read_text()), "seconds": 3}))
    assert kept("cpu", 1) is None


def test_a_machine_without_a_cache_is_told_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    keep(MADE, "cpu")
    assert "warning: " in capsys.readouterr().err
    assert kept("cpu", 1) is None


def test_without_xdg_the_cache_is_in_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    keep(MADE, "cpu")
    assert (tmp_path / ".cache" / "defocus" / "calibration-cpu-1.json").is_file()


def test_threads_that_have_no_tile_left_wait() -> None:
    one = replace(MADE, seconds=MADE.seconds | {"regions": 0.0})
    four = replace(one, threads=4)
    assert one.predicted_seconds(planned(6)) == 1
    assert four.predicted_seconds(planned(6)) == pytest.approx(8 / 6)
    assert four.predicted_seconds(planned(8)) == 1
    assert four.predicted_seconds(planned(8, regions=3)) > 1  # a thread without a region
    assert four.predicted_seconds(planned(8, regions=4)) == 1


def test_threads_wait_for_the_work_of_a_region_and_for_regions_that_are_no_copies() -> None:
    four = replace(MADE, seconds=MADE.seconds | {"regions": 0.0}, threads=4)
    assert four.predicted_seconds(planned(8, alone=True)) == 4
    assert four.predicted_seconds(planned(8, regions=4, alone=True)) == 1
    assert four.predicted_seconds(planned(8, regions=4, busy=1, alone=True)) == 4


def test_each_thread_holds_what_it_works_on() -> None:
    one, four = MADE, replace(MADE, threads=4)
    # backdrop, spectra, cells; region, layers, discs; tile, making
    frame, region, tile = 3, 3, 2
    assert one.predicted_mb(planned(6)) == frame + region + 1 + tile
    assert four.predicted_mb(planned(6)) == frame + region + 1 + 4 * tile
    assert four.predicted_mb(planned(8, regions=4)) == frame + 4 * region + 4 + 4 * tile
    assert four.predicted_mb(planned(1)) == frame + region + 1 + tile


def test_fewer_regions_at_once_hold_less() -> None:
    four, plan = replace(MADE, threads=4), planned(160, regions=40)
    held = [four.predicted_mb(plan, at_once) for at_once in (1, 2, 4)]
    assert held[0] < held[1] < held[2] == four.predicted_mb(plan)


def test_a_measurement_tells_more_work_from_less(monkeypatch: pytest.MonkeyPatch) -> None:
    some = [
        scene
        for scene in calibration._SCENES
        if scene[1] * scene[2] <= 256 * 256 and scene[3] < 50 and scene[4] != "high"
    ]
    monkeypatch.setattr(calibration, "_SCENES", tuple(some))
    found = calibration.measured("cpu", 1)
    small, large = (
        plan(scenery("floor", 200, width, r).signed_radius)
        for width, r in ((100, 2.0), (400, 20.0))
    )
    assert found.predicted_seconds(large) > 2 * found.predicted_seconds(small) > 0
    assert found.predicted_mb(large) > found.predicted_mb(small) > 0
