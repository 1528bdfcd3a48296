"""The scene of a picture decides its split, whatever else is in the dataset."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from defocus_core.batch.jobs.job import Picture
from defocus_core.batch.jobs.splits import read_splits
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.errors import UsageProblem


def splits(**values: Any):
    return read_splits(Table(Path("jobs.toml"), "split", values))


def picture(stem: str, frame: int | None = None) -> Picture:
    return Picture(stem, Path("a.exr"), Path("z.exr"), frame=frame)


def test_each_split_has_its_share_of_the_scenes() -> None:
    of = splits(train=0.8, val=0.15, test=0.05).of
    counts = Counter(of(picture(f"scene{number}")) for number in range(20_000))
    assert counts["train"] == pytest.approx(16_000, abs=250)  # over 4 standard deviations
    assert counts["val"] == pytest.approx(3_000, abs=220)
    assert counts["test"] == pytest.approx(1_000, abs=140)


def test_a_scene_keeps_its_split_and_frames_share_it() -> None:
    of = splits(train=0.5, test=0.5).of
    assert [of(picture(name)) for name in "abcdef"] == [
        *("train", "test", "train", "test", "train", "train"),
    ]  # as they are on every machine, for ever
    shots = {name: {of(picture(f"{name}.{n}", n)) for n in range(9)} for name in ("s1", "s2")}
    assert all(len(found) == 1 for found in shots.values())


def test_an_expression_says_what_a_scene_is() -> None:
    of = splits(train=0.5, test=0.5, scene=r"^(\w+)_\d+$").of
    for scene in "abcdef":
        assert len({of(picture(f"{scene}_{n}")) for n in range(9)}) == 1
    with pytest.raises(UsageProblem, match="finds no scene in 'x'"):
        of(picture("x"))


def test_without_splits_there_is_none() -> None:
    assert splits().of(picture("a")) == ""


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"train": 0.9}, "add up to 0.9"),
        ({"train": 1.5}, "no share"),
        ({"train": True}, "no share"),
        ({"tr/ain": 1.0}, "no name of a split"),
        ({"scene": "a"}, "without shares"),
        ({"train": 1.0, "scene": "("}, "no regular expression"),
    ],
)
def test_shares_that_make_no_sense_are_refused(values: dict[str, Any], problem: str) -> None:
    with pytest.raises(UsageProblem, match=problem):
        splits(**values)
