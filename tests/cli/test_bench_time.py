"""``defocus bench --time`` on scenes of a few pixels."""

import json
from pathlib import Path
from time import sleep

import pytest
import torch
from command_line import refused, run

from defocus_core.bench.timing import Baseline, Case, FftUnit, MeasuredCost, cases, measured
from defocus_core.evaluation.synthetic_scenes import KINDS
from defocus_core.system import memory

TINY = ("--sizes", "32x24", "--radii", "2", "--device", "cpu")


def bench(*args):
    return run("bench", "--time", *args)


CASE = Case("floor", (480, 270), 8.0, "standard")


def cost(fft_units):
    return MeasuredCost(1.0, fft_units, None)


@pytest.fixture(scope="module")
def ran():
    """A run of tiny cases."""
    return bench(*TINY, "--json")


@pytest.fixture(scope="module")
def stored(ran, tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "t.json"
    path.write_text(ran.out)
    return path


def test_everything_is_timed_and_written(ran):
    assert ran.code == 0
    document = ran.json
    assert (document["threads"], document["device"]) == (1, "cpu")
    names = [row["case"] for row in document["rows"]]
    assert len(names) == len(set(names)) == len(KINDS)
    assert {"floor-32x24-r2-standard", "focus-32x24-r0-standard"} < set(names)
    assert all(row["seconds"] > 0 and row["fft_units"] > 0 for row in document["rows"])
    assert [line.split()[0] for line in ran.err.splitlines()[1:]] == list(KINDS)


@pytest.mark.parametrize(("seconds", "times"), [(0.0, 4), (1.01, 1)])
def test_work_is_repeated_as_often_as_asked_for_unless_it_is_long(seconds, times):
    frame, calls = torch.zeros(1, 8, 8), []

    def work():
        calls.append(1)
        sleep(seconds)
        return frame

    measured(work, FftUnit(frame), repeats=4)
    assert len(calls) == times


def test_the_cost_in_transforms_is_the_ratio_of_times(monkeypatch):
    frame = torch.zeros(1, 8, 8)
    unit = FftUnit(frame)
    around = iter([0.01, 0.03])  # s of the unit before and after: 0.02 on average
    monkeypatch.setattr(unit, "seconds", lambda: next(around))
    cosine_cost = measured(lambda: frame.cos(), unit, repeats=1)[1]
    assert cosine_cost.fft_units == pytest.approx(cosine_cost.seconds / 0.02)


def test_what_is_in_focus_is_timed_once():
    found = cases([(8, 8)], [8.0, 2.0], ["draft"])
    radii = {kind: [case.radius for case in found if case.kind == kind] for kind in KINDS}
    assert radii.pop("focus") == [0.0]
    assert all(own == [2.0, 8.0] for own in radii.values())


def scaled(stored, path, change):
    document = json.loads(stored.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def slow_down(factor):
    def change(document):
        for row in document["rows"]:
            row["fft_units"] /= factor

    return change


def test_slower_than_stored_is_told_with_exit_code_one(stored, tmp_path):
    base = scaled(stored, tmp_path / "b.json", slow_down(20.0))
    ran = bench(*TINY, "--baseline", base, "--json")
    assert ran.code == 1
    assert "! floor-32x24-r2-standard: " in ran.err
    assert "7 of 7 cases slower than stored by more than 25 %" in ran.err
    assert all(case["ratio"] > 1.25 for case in ran.json["baseline"])
    assert len(ran.json["slower"]) == 7


def test_as_fast_as_stored_is_fine(stored, tmp_path):
    base = scaled(stored, tmp_path / "b.json", slow_down(0.05))
    ran = bench(*TINY, "--quality", "draft,standard", "--baseline", base)
    assert ran.code == 0
    assert "0 of 7 cases slower" in ran.out  # drafts are not stored


def test_a_case_that_was_slow_once_is_timed_again():
    stored = Baseline(Path("b.json"), 1, "cpu", {CASE.name: 5.0})
    quick, slow = cost(5.0), cost(9.0)
    assert stored.confirmed({CASE: slow}, lambda case: quick) == {CASE: quick}
    assert stored.confirmed({CASE: quick}, lambda case: slow) == {CASE: quick}
    assert stored.confirmed({CASE: slow}, lambda case: cost(9.5)) == {CASE: slow}, "the faster one"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda d: d.update(threads=3), "other-machine"),
        (lambda d: d.update(rows=[]), "empty"),
        (lambda d: d.pop("rows"), "malformed"),
        (lambda d: d["rows"][0].update(fft_units=0), "damaged"),
    ],
)
def test_what_cannot_be_compared_is_refused(stored, tmp_path, change, code):
    base = scaled(stored, tmp_path / "b.json", change)
    ran = bench(*TINY, "--baseline", base)
    refused(ran, 3, code, base)


@pytest.mark.parametrize(
    ("args", "code", "at"),
    [
        (("--time", "--sizes", "480"), "malformed", "sizes"),
        (("--time", "--radii", "8,-1"), "malformed", "radii"),
        (("--time", "--truth", "x"), "contradiction", "--truth"),
        (("--radii", "8"), "contradiction", "--radii"),
        (("--baseline", "x"), "contradiction", "--baseline"),
    ],
)
def test_options_that_make_no_sense_are_refused(args, code, at):
    refused(run("bench", *args), 2, code, at)


def test_a_missing_baseline_is_refused_before_the_work(tmp_path):
    refused(bench(*TINY, "--baseline", tmp_path / "no.json"), 3, "not-found", "no.json")


def test_the_peak_begins_anew():
    if not memory.held_mb():
        pytest.skip("not on this system: it does not tell")
    block = bytearray(64 * memory.MB)
    block[::4096] = bytes(len(block[::4096]))
    high = memory.peak_mb()
    del block
    memory.reset_peak()
    low = memory.peak_mb()
    assert low < high - 32
    assert memory.held_mb() <= low + 1
    available = memory.available_mb()
    assert available > 0
