"""``defocus bench --time`` on scenes of a few pixels."""

from time import sleep
from types import SimpleNamespace

import pytest
import torch
from command_line import refused, run

from defocus_core.bench.timing import FftUnit, cases, measured
from defocus_core.evaluation.synthetic_scenes import KINDS
from defocus_core.system import memory

TINY = ("--sizes", "32x24", "--radii", "2", "--device", "cpu")


def bench(*args):
    return run("bench", "--time", *args)


@pytest.fixture(scope="module")
def ran():
    """A run of tiny cases."""
    return bench(*TINY, "--json")


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


def test_the_cost_in_transforms_is_the_ratio_of_times():
    frame = torch.zeros(1, 8, 8)
    around = iter([0.01, 0.03])  # s of the unit before and after: 0.02 on average
    unit = SimpleNamespace(device="cpu", seconds=lambda: next(around))
    cosine_cost = measured(lambda: frame.cos(), unit, repeats=1)[1]
    assert cosine_cost.fft_units == pytest.approx(cosine_cost.seconds / 0.02)


def test_what_is_in_focus_is_timed_once():
    found = cases([(8, 8)], [8.0, 2.0], ["high"])
    radii = {kind: [case.radius for case in found if case.kind == kind] for kind in KINDS}
    assert radii.pop("focus") == [0.0]
    assert all(own == [2.0, 8.0] for own in radii.values())


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


def test_a_table_of_launches_goes_where_one_is(tmp_path):
    (tmp_path / "notes.md").write_text("mine")
    refused(run("bench", "--launches", tmp_path / "notes.md"), 3, "malformed", "notes.md")
    assert (tmp_path / "notes.md").read_text() == "mine"
    ran = run("bench", "--launches", tmp_path / "new.md", "--threads", "2")
    refused(ran, 2, "contradiction", "--threads")
