"""How many faults of many kinds are named rightly, wrongly or not at all, scene by scene."""

from __future__ import annotations

from pathlib import Path

import compare_pairs
import pytest

from defocus_core.compare.comparison import compare_pair
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.compare.thresholds import PRESETS

_PLACE = "spread otherwise"  # says how light moved, and claims no cause
_EITHER = "another CoC or bokeh shape"


def judged(pair: compare_pairs.Pair) -> Comparison:
    files = FilePair(pair.b.name, pair.a, pair.b)
    return compare_pair(files, PRESETS["render"], CompareSettings())[0]


@pytest.mark.bench
@pytest.mark.parametrize(
    ("scene", "min_right", "max_wrong"),
    [("spheres", 110, 1), ("lights", 95, 2), ("leaves", 102, 1)],
)
def test_faults_are_named_or_said_and_none_is_silent(
    scene: str, min_right: int, max_wrong: int, tmp_path: Path
) -> None:
    right, wrong = 0, []
    for pair in compare_pairs.faults(tmp_path, scene):
        record = judged(pair)
        assert record.status != "same", pair.kind
        names = [each.name for each in record.findings if each.name != _PLACE]
        bokeh = "another bokeh shape" in pair.right and _EITHER in names
        if bokeh or any(name.startswith(pair.right) for name in names):
            right += 1
        elif names:
            wrong.append(f"{pair.kind}: {names}")
    assert right >= min_right
    assert len(wrong) <= max_wrong, wrong


@pytest.mark.bench
@pytest.mark.parametrize("scene", ["spheres", "lights", "leaves"])
def test_at_most_one_benign_pair_fails(scene: str, tmp_path: Path) -> None:
    pairs = compare_pairs.benign(tmp_path, scene)
    assert sum(not judged(pair).passes for pair in pairs) <= 1
