"""How many faults of many kinds are named rightly, wrongly or not at all, scene by scene."""

from __future__ import annotations

import compare_pairs
import pytest
from planted_faults import compared

from defocus_core.compare.findings.finding import is_place
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
