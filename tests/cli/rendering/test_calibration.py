"""The rate of this machine is measured."""

from __future__ import annotations

import pytest

from defocus_cli.rendering import calibration


def test_a_measurement_renders_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "_SCENE", ("cards", 48, 64, 3.0))
    calibration.work_per_second.cache_clear()
    assert 1e5 < calibration.work_per_second("cpu", 1) < 1e12
    calibration.work_per_second.cache_clear()
