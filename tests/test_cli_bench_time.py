"""``defocus bench --time`` on scenes of a few pixels."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import Ran, Terminal, refused, run

from defocus_cli import bench_time, memory
from defocus_cli.bench_baseline import faster
from defocus_cli.bench_options import Times
from defocus_cli.bench_scaling import exponents
from defocus_cli.bench_time import KINDS, OUTPUTS, Case, Timing, cases
from defocus_cli.bench_time_table import record
from defocus_cli.scene_rendering import Rendered, rendered_scene
from defocus_core import scenery

TINY = ("--sizes", "32x24", "--radii", "2", "--repeat", "1")


def bench(*args: str | Path) -> Ran:
    return run("bench", "--time", *args)


def timing(seconds: float, fft_units: float = 10.0, **changed: Any) -> Timing:
    values = {"kind": "floor", "size": (480, 270), "radius": 8.0}
    case = Case(**{**values, "quality": "standard", "outputs": "centre", **changed})
    slices = 4.0 * case.radius**0.5
    stats = {"slices": slices, "slice_tiles": 8.0, "slice_tiles_done": 2.0}
    return Timing(case, seconds, seconds, fft_units, None, 1, stats)


def test_the_kinds_are_those_of_the_core() -> None:
    assert list(KINDS) == list(scenery.KINDS)


def test_everything_is_timed_and_written(tmp_path: Path) -> None:
    files = ("--json", tmp_path / "t.json", "--csv", tmp_path / "t.csv")
    args = ("--quality", "draft,standard", "--kinds", "floor,focus", "--outputs", "centre,all")
    ran = bench(*TINY, *args, *files)
    assert (ran.code, ran.err) == (0, "")
    document = json.loads((tmp_path / "t.json").read_text())
    assert (document["threads"], document["device"], document["repeat"]) == (1, "cpu", 1)
    names = [row["case"] for row in document["rows"]]
    assert len(names) == len(set(names)) == 8
    assert "floor-32x24-r2-draft-all" in names
    assert "focus-32x24-r0-standard-centre" in names
    for row in document["rows"]:
        assert row["seconds"] > 0
        assert row["cpu_seconds"] > 0
        assert row["fft_units"] > 0
        assert row["slices"] >= 3
        assert 0 <= row["work_percent"] <= 100
        assert (row["work_percent"] == 0) == (row["kind"] == "focus")  # a copy
    with (tmp_path / "t.csv").open() as file:
        told = [row["case"] for row in csv.DictReader(file)]
    assert told == names
    assert [line.split()[0] for line in ran.out.splitlines()[1:9]] == ["floor"] * 4 + ["focus"] * 4


@pytest.mark.parametrize(("outputs", "left_right"), [("centre", False), ("pair", True)])
def test_a_pair_is_rendered_where_it_is_asked_for(
    outputs: str, left_right: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def spy(*args: Any, **settings: Any) -> Rendered:
        asked.append(settings["left_right"])
        return rendered_scene(*args, **settings)

    monkeypatch.setattr(bench_time, "rendered_scene", spy)
    case = Case("floor", (32, 24), 2.0, "draft", outputs)
    bench_time.measure(case, device="cpu", threads=1, repeat=1)
    assert asked == [left_right]


def test_a_case_is_repeated_as_often_as_asked_for_unless_it_is_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = Case("plane", (16, 16), 2.0, "draft", "centre")
    measured = bench_time.measure(case, device="cpu", threads=1, repeat=4)
    assert measured.repeats == 4
    monkeypatch.setattr(bench_time, "_ENOUGH", 0.0)
    assert bench_time.measure(case, device="cpu", threads=1, repeat=4).repeats == 1


def test_what_is_quick_and_what_is_full() -> None:
    usual = {"kinds": (), "sizes": (), "radii": (), "outputs": ()}
    asked = {"baseline": None, "tolerance": 0.1, "predict": False}
    quick = Times(**usual, full=False, **asked).cases(())
    full = Times(**usual, full=True, **asked).cases(())
    assert {c.kind for c in quick} == {c.kind for c in full} == set(KINDS)
    assert {c.radius for c in full} == {0.0, 2.0, 8.0, 32.0, 128.0}
    assert {c.size[0] for c in full} == {480, 960, 1920, 3840}
    assert {c.outputs for c in full} == set(OUTPUTS)
    assert max(c.size[0] for c in quick) == 960
    some = Times(**{**usual, "radii": (3.0,)}, full=True, **asked).cases(("high",))
    assert {c.radius for c in some} == {0.0, 3.0}
    assert {c.quality for c in some} == {"high"}


def test_what_is_in_focus_is_timed_once() -> None:
    found = cases(["focus", "floor"], [(8, 8)], [2.0, 8.0], ["draft"], ["centre"])
    assert [(case.kind, case.radius) for case in found] == [
        ("focus", 0.0),
        ("floor", 2.0),
        ("floor", 8.0),
    ]


def test_exponents_are_those_that_the_times_were_made_with() -> None:
    sizes = [(480, 270), (960, 540), (1920, 1080)]
    made = [
        timing(k * (w * h) ** 1.1 * r**0.5, size=(w, h), radius=r, outputs=outputs)
        for outputs, k in (("centre", 1e-6), ("all", 3e-6))
        for w, h in sizes
        for r in (2.0, 8.0, 32.0)
    ]
    (found,) = exponents(made)
    assert found["kind"] == "floor"
    assert found["pixels"] == pytest.approx(1.1)
    assert found["radius"] == pytest.approx(0.5)
    assert found["slices"] == pytest.approx(1.0)  # slices grow like the root of r here


def test_there_is_no_exponent_of_what_was_not_varied() -> None:
    assert exponents([timing(1.0)]) == [
        {"kind": "floor", "pixels": None, "radius": None, "slices": None}
    ]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of one tiny case."""
    path = tmp_path_factory.mktemp("stored") / "t.json"
    assert bench(*TINY, "--kinds", "floor", "--json", path).code == 0
    return path


def scaled(stored: Path, path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    document = json.loads(stored.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def slow_down(factor: float) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        for row in document["rows"]:
            row["fft_units"] /= factor

    return change


def test_slower_than_stored_is_told_with_exit_code_one(stored: Path, tmp_path: Path) -> None:
    base = scaled(stored, tmp_path / "b.json", slow_down(20.0))
    args = ("--kinds", "floor", "--baseline", base, "--json", tmp_path / "now.json")
    ran = bench(*TINY, *args)
    assert ran.code == 1
    assert "! floor-32x24-r2-standard-centre: " in ran.out
    assert "1 of 1 cases slower than stored by more than 25 %" in ran.out
    (case,) = json.loads((tmp_path / "now.json").read_text())["baseline"]["cases"]
    assert case["ratio"] > 1.25
    assert bench(*TINY, "--kinds", "floor", "--baseline", base, "--tolerance", "999").code == 0


def test_as_fast_as_stored_is_fine(stored: Path, tmp_path: Path) -> None:
    base = scaled(stored, tmp_path / "b.json", slow_down(0.05))
    ran = bench(*TINY, "--kinds", "floor,plane", "--baseline", base)
    assert ran.code == 0
    assert "0 of 1 cases slower" in ran.out  # the plane is not stored


def test_of_two_timings_the_faster_counts() -> None:
    quick, slow = timing(1.0, 5.0), timing(1.0, 6.0)
    assert faster(quick, slow) is faster(slow, quick) is faster(None, quick) is quick


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(threads=3), ("--threads 3",)),
        (lambda d: d.update(rows=[]), ("none of the cases",)),
        (lambda d: d.pop("rows"), ("is no stored run", "KeyError")),
        (lambda d: d["rows"][0].update(fft_units=0), ("not positive",)),
    ],
)
def test_what_cannot_be_compared_is_refused(
    stored: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object], words: tuple[str, ...]
) -> None:
    base = scaled(stored, tmp_path / "b.json", change)
    ran = bench(*TINY, "--kinds", "floor", "--baseline", base)
    refused(ran, 3, f"defocus: {base}: ", *words)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--time", "--sizes", "480"), ("--sizes", "'480' is no size", "480x270")),
        (("--time", "--radii", "8,-1"), ("--radii", "'-1' is no radius")),
        (("--time", "--kinds", "flor"), ("--kinds", "'flor'", "floor")),
        (("--time", "--truth", "x"), ("--truth", "means nothing with --time")),
        (("--time", "--no-baselines"), ("--no-baselines", "means nothing with --time")),
        (("--radii", "8"), ("--radii", "means nothing without --time")),
        (("--full",), ("--full", "means nothing without --time")),
    ],
)
def test_options_that_make_no_sense_are_refused(
    args: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refused(run("bench", *args), 2, *words)


def test_a_missing_baseline_is_refused_before_the_work(tmp_path: Path) -> None:
    refused(bench(*TINY, "--baseline", tmp_path / "no.json"), 3, "no.json", "cannot be read")


def test_progress_is_for_terminals() -> None:
    assert "rendering" in run("bench", "--time", *TINY, "--kinds", "plane", err=Terminal()).err


def test_predictions_stand_beside_what_was_measured(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    ran = bench(*TINY, "--kinds", "floor,plane", "--predict", "--json", path)
    rows = json.loads(path.read_text())["rows"]
    for row, line in zip(rows, ran.out.splitlines()[1:], strict=False):
        assert row["predicted_seconds"] > 0.01  # of each frame, in the cache of the tests
        assert row["predicted_mb"] > 10
        assert line.split()[-2] == f"{row['predicted_seconds']:.3f}"
    assert "of 2 predicted within a factor of 1.5; farthest off" in ran.out
    assert "pred. s  pred. MB" in ran.out
    assert "predicted" not in bench(*TINY, "--kinds", "floor").out


def test_records_tell_the_share_of_the_work() -> None:
    assert record(timing(1.0))["work_percent"] == 25.0


def test_the_peak_begins_anew() -> None:
    if not memory.held_mb():
        pytest.skip("this system does not tell")
    block = bytearray(64 * memory.MB)
    block[::4096] = bytes(len(block[::4096]))
    high = memory.peak_mb()
    del block
    memory.reset_peak()
    low = memory.peak_mb()
    assert high is not None
    assert low is not None
    assert low < high - 32
    assert memory.held_mb() <= low + 1
    available = memory.available_mb()
    assert available is not None
    assert available > 0
