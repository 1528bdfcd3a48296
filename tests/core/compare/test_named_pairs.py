"""How many faults of many kinds are named rightly, wrongly or not at all, scene by scene."""

from collections import Counter
from pathlib import Path

import pytest
from planted_faults import BENIGN, KINDS, SCENES, judged, pair

from defocus_core.compare.findings.table import FINDINGS


@pytest.mark.bench
@pytest.mark.parametrize("scene", ["spheres", "lights", "leaves"])
def test_no_benign_pair_fails(scene):
    assert [kind for kind, row in BENIGN.items() if not pair(row, scene, 0.5, 0).passes] == []


def test_the_help_has_a_row_for_each_finding():
    text = (Path(__file__).parents[3] / "defocus_cli/help/compare.md").read_text()
    assert [name for name in FINDINGS if f"| `{name}` | " not in text] == []


# Of kinds of which test_findings has no picture.
_STRONG = (
    *("depth normalised", "radial depth", "ids shuffled", "light missing", "grey object"),
    *("right half moved", "blurred tile", "object moved", "JPEG", "inverted, PNG", "focus moved"),
    *("gain of tiles", "divided by alpha", "multiplied by alpha", "overscan cropped", "grain, PNG"),
    *("hot pixels, PNG", "dark border, PNG", "moved by sinc", "sharpened, PNG"),
)


@pytest.mark.parametrize("kind", _STRONG)
def test_a_strong_fault_of_a_kind_is_named(kind):
    verdict, said = judged(KINDS[kind], pair(KINDS[kind], "spheres", 0.8, 1))
    assert verdict == "right", said


@pytest.mark.bench
def test_kinds_of_faults_are_named_from_barely_visible_to_strong():
    scenes = [name for name, folder in SCENES.items() if folder.is_dir()]
    counts = Counter()
    for number, row in enumerate(KINDS.values()):
        for k in range(20):
            scene = scenes[(3 * k + number) % len(scenes)]
            counts[judged(row, pair(row, scene, (k + 0.5) / 20, k))[0]] += 1
    print({verdict: f"{count / counts.total():.1%}" for verdict, count in counts.items()})  # noqa: T201
    assert counts["right"] >= 0.92 * counts.total()
    assert counts["wrong"] <= 0.01 * counts.total()
    assert not counts["silent"]
