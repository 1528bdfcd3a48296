"""The rate of this machine: measured once, kept, and measured anew where that does not hold."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from defocus_cli.rendering import calibration
from defocus_cli.rendering.calibration import keep, kept, work_per_second


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "defocus"


def test_a_rate_is_measured_once_and_kept(
    cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibration, "measured", lambda device, threads: 5e8)
    assert kept("cpu", 1) is None
    assert work_per_second("cpu", 1) == 5e8
    assert str(cache) in capsys.readouterr().err
    monkeypatch.setattr(calibration, "measured", None)
    assert work_per_second("cpu", 1) == kept("cpu", 1) == 5e8
    assert capsys.readouterr().err == ""
    assert kept("cpu", 2) is None, "other threads have another rate"


def test_another_version_is_measured_anew(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(5e8, "cpu", 1)
    monkeypatch.setattr(calibration, "version", lambda: "another")
    assert kept("cpu", 1) is None


@pytest.mark.parametrize("text", ["", "{", "[]", '{"key": 1}', '{"work_per_second": 2}'])
def test_a_damaged_file_is_measured_anew(cache: Path, text: str) -> None:
    keep(5e8, "cpu", 1)
    (file,) = cache.iterdir()
    file.write_text(text)
    assert kept("cpu", 1) is None


@pytest.mark.parametrize("rate", [0, -1.0, "fast", None])
def test_what_is_no_rate_is_measured_anew(cache: Path, rate: object) -> None:
    keep(5e8, "cpu", 1)
    (file,) = cache.iterdir()
    file.write_text(json.dumps(json.loads(file.read_text()) | {"work_per_second": rate}))
    assert kept("cpu", 1) is None


def test_a_machine_without_a_cache_is_told_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(calibration, "measured", lambda device, threads: 5e8)
    assert work_per_second("cpu", 1) == 5e8
    assert "the machine is measured each time" in capsys.readouterr().err


def test_without_xdg_the_cache_is_in_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    keep(5e8, "cpu", 1)
    assert (tmp_path / ".cache" / "defocus" / "rate-cpu-1.json").exists()


def test_a_measurement_renders_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "_SCENE", ("cards", 48, 64, 3.0))
    assert 1e5 < calibration.measured("cpu", 1) < 1e12
