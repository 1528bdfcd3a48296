"""How many faults of many kinds are named rightly, wrongly or not at all, scene by scene."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import compare_pairs
import fault_kinds
import pytest
from planted_faults import compared

from defocus_core.compare.findings import table
from defocus_core.compare.findings.table import is_place
from defocus_core.compare.thresholds import PRESETS

# Say how light moved, or that two causes tie, or that it is slight: no cause is claimed.
_NO_CAUSE = ("spread otherwise", "softened", "too small to name")
_EITHER = "another CoC or bokeh shape"


def judged(pair):
    return compared(pair.a, pair.b, PRESETS["render"])


@pytest.mark.bench
@pytest.mark.parametrize("scene", ["spheres", "lights", "leaves"])
def test_faults_are_named_or_said_and_none_is_silent(scene, tmp_path):
    right, wrong, pairs = 0, [], compare_pairs.faults(tmp_path, scene)
    for pair in pairs:
        record = judged(pair)
        assert record.status != "same" or not record.differing, pair.kind
        said = [each.name for each in record.findings if not is_place(each.name)]
        names = [name for name in said if name not in _NO_CAUSE or name in pair.right]
        bokeh = "another bokeh shape" in pair.right and _EITHER in names
        if bokeh or any(name.startswith(pair.right) for name in names):
            right += 1
        elif names:
            wrong.append(f"{pair.kind}: {names}")
    assert right >= 0.88 * len(pairs)
    assert len(wrong) <= 0.03 * len(pairs), wrong


@pytest.mark.bench
@pytest.mark.parametrize("scene", ["spheres", "lights", "leaves"])
def test_at_most_one_benign_pair_fails(scene, tmp_path):
    pairs = compare_pairs.benign(tmp_path, scene)
    assert sum(not judged(pair).passes for pair in pairs) <= 1


def test_the_help_has_the_rows_of_the_table():
    text = (Path(__file__).parents[3] / "defocus_cli/help/compare.md").read_text()
    assert [line for line in table.help_lines() if line not in text] == []


_STRONG = (
    *("depth normalised", "text", "watermark, PNG", "6 bits in 8", "line of garbage"),
    *("radial depth", "lift, PNG", "alpha eroded", "specular missing", "chromatic aberration"),
    *("light missing", "cropped to black", "overscan cropped", "right half moved", "blurred tile"),
    *("grey object", "resized and back", "ghost", "bloom, PNG", "object moved", "lens distortion"),
    "noise removed, PNG",
)


@pytest.mark.parametrize("kind", _STRONG)
def test_a_strong_fault_of_a_kind_is_named(kind):
    verdict, said = fault_kinds.judged(kind, fault_kinds.pair(kind, "spheres", 0.8, 1))
    assert verdict == "right", said


@pytest.mark.bench
def test_kinds_of_faults_are_named_from_barely_visible_to_strong():
    scenes = [name for name, folder in fault_kinds.SCENES.items() if folder.is_dir()]
    counts = Counter()
    for number, kind in enumerate(fault_kinds.KINDS):
        for k in range(20):
            scene = scenes[(3 * k + number) % len(scenes)]
            record = fault_kinds.pair(kind, scene, (k + 0.5) / 20, k)
            counts[fault_kinds.judged(kind, record)[0]] += 1
    print({verdict: f"{count / counts.total():.1%}" for verdict, count in counts.items()})  # noqa: T201
    assert counts["right"] >= 0.93 * counts.total()
    assert counts["wrong"] <= 0.02 * counts.total()
    assert not counts["silent"]
