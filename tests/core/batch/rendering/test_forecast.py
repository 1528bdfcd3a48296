"""The rate of this machine is measured."""

from __future__ import annotations

import pytest

from defocus_core.batch.rendering import forecast
from defocus_core.batch.rendering.forecast import work_per_second  # before tests replace it


def test_a_measurement_renders_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forecast, "_SCENE", ("cards", 48, 64, 3.0))
    work_per_second.cache_clear()
    assert 1e5 < work_per_second("cpu", 1) < 1e12
    work_per_second.cache_clear()
