"""The scene of a picture decides its split, whatever other scenes there are."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses_as

from defocus_core.batch.jobs.job import Picture
from defocus_core.batch.jobs.scene_pattern import ScenePattern
from defocus_core.batch.jobs.splits import read_splits
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.errors import UsageProblem


def splits(**values: Any):
    return read_splits(Table(Path("jobs.toml"), "split", values))


def picture(stem: str, frame: int | None = None) -> Picture:
    return Picture(stem, Path("a.exr"), Path("z.exr"), frame=frame)


def assigned(names: Any, **values: Any) -> dict[str, str]:
    return dict(zip(names, splits(**values).assign([picture(n) for n in names]), strict=True))


@given(shares=st.lists(st.integers(1, 20), min_size=1, max_size=4))
def test_each_split_has_its_share_of_the_scenes_in_the_long_run(shares: list[int]) -> None:
    wanted = {f"s{n}": share / sum(shares) for n, share in enumerate(shares)}
    found = Counter(assigned([f"scene{n}" for n in range(2000)], **wanted).values())
    for name, share in wanted.items():
        assert abs(found[name] / 2000 - share) < 0.05  # more than four standard deviations


@given(names=st.sets(st.text("abc123", min_size=1), min_size=2))
def test_no_scene_moves_when_another_is_added_removed_or_renamed(names: set[str]) -> None:
    every = assigned(sorted(names), train=0.7, val=0.1, test=0.2)
    for left_out in names:
        others = assigned(sorted(names - {left_out} | {"other"}), train=0.7, val=0.1, test=0.2)
        assert all(every[name] == others[name] for name in names - {left_out})


@given(
    items=st.lists(
        st.tuples(
            st.sampled_from(["a", ".", "[ab]", r"\d", "^", "$", r"\b", "(a|b)", "(?:a|bb)", "|"]),
            st.sampled_from(["", "*", "+", "?", "+?", "*?", "{2}", "{1,2}?", "{1,}"]),
        ),
        max_size=5,
    ),
    name=st.text("ab1_", max_size=8),
)
def test_a_scene_is_what_pythons_own_matcher_finds(items: list[Any], name: str) -> None:
    text = "".join(atom + (repeat if atom not in "^$|\\b" else "") for atom, repeat in items)
    expression = re.compile(text)
    found = expression.search(name)
    wanted = found[1 if expression.groups else 0] if found else None
    assert ScenePattern(text).scene(name) == wanted


@pytest.mark.parametrize("text", ["(", r"(a)\1", "(?=a)", "(?i)a", "a++", "(a{1,99}){1,99}", "[a"])
def test_an_expression_that_could_take_for_ever_is_refused(text: str) -> None:
    with refuses_as("malformed scene"):
        splits(train=1, scene=text)


def test_splits_without_a_scene_are_said(caplog: pytest.LogCaptureFixture) -> None:
    assert set(assigned("ac", train=0.5, val=0.25, test=0.25).values()) == {"train"}
    assert "none of 2 scenes is in val, test" in caplog.text


def test_the_frames_of_a_shot_share_their_split() -> None:
    shots = [picture(f"{name}.{n}", n) for name in ("a", "b") for n in range(9)]
    found = splits(train=0.5, test=0.5).assign(shots)
    assert (len(set(found[:9])), len(set(found[9:]))) == (1, 1)


def test_an_expression_says_what_a_scene_is() -> None:
    both = splits(train=0.5, test=0.5, scene=r"^(\w+)_\d+$")
    found = both.assign([picture(f"{scene}_{n}") for n in range(9) for scene in "ab"])
    assert (set(found[::2]), set(found[1::2])) == ({"train"}, {"test"})
    with pytest.raises(UsageProblem) as caught:
        both.assign([picture("x")])
    assert caught.value.code == "no-scene"


def test_without_splits_there_is_none() -> None:
    assert splits().assign([picture("a")]) == [""]


@pytest.mark.parametrize(
    ("values", "refusal"),
    [
        ({"train": 0.9}, "malformed [split]"),
        ({"train": 1.5}, "malformed train"),
        ({"train": True}, "malformed train"),
        ({"tr/ain": 1.0}, "malformed tr/ain"),
        ({"scene": "a"}, "missing-option scene"),
        ({"train": 1.0, "scene": "("}, "malformed scene"),
    ],
)
def test_shares_that_make_no_sense_are_refused(values: dict[str, Any], refusal: str) -> None:
    with refuses_as(refusal):
        splits(**values)
