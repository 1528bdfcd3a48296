"""The scene of a picture decides its split, whatever other scenes there are."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jobs_files import job_of
from refusals import refuses, refuses_as

from defocus_core.request.splits import read_splits, with_recorded
from defocus_core.request.toml_file import Table


def splits(*pictures, **values):
    return read_splits(Table(Path("jobs.toml"), "split", values), pictures)


def plain(name):
    return job_of(Path("a.exr"), Path("z.exr"), Path("out"), name=name)


def picture(stem, frame=None):
    return replace(
        job_of(Path("a.exr"), Path("z.exr"), Path("out"), name=stem).picture, frame=frame
    )


def assigned(names, **values):
    found = splits(*map(picture, names), **values)
    return {name: split.name for name, split in zip(names, found, strict=True)}


def job(name, **values):
    (split,) = splits(picture(name), **values)
    return replace(plain(name), split=split)


def kept(recorded, names, **values):
    jobs = with_recorded([job(name, **values) for name in names], recorded)
    return {each.sample_id: each.split.name for each in jobs}


@settings(deadline=None, max_examples=10)
@given(shares=st.lists(st.integers(1, 20), min_size=1, max_size=4))
def test_each_split_has_its_share_of_the_scenes_in_the_long_run(shares):
    wanted = {f"s{n}": share / sum(shares) for n, share in enumerate(shares)}
    found = Counter(assigned([f"scene{n}" for n in range(2000)], **wanted).values())
    for name, share in wanted.items():
        assert abs(found[name] / 2000 - share) < 0.05  # more than four standard deviations


@settings(deadline=None, max_examples=30)
@given(names=st.sets(st.text("abc123", min_size=1), min_size=2))
def test_no_scene_moves_when_another_is_added_removed_or_renamed(names):
    every = assigned(sorted(names), train=0.7, val=0.1, test=0.2)
    for left_out in names:
        others = assigned(sorted(names - {left_out} | {"other"}), train=0.7, val=0.1, test=0.2)
        assert all(every[name] == others[name] for name in names - {left_out})


def test_a_scene_stays_where_it_is_recorded_and_splits_without_one_are_said(caplog):
    shares = {"train": 0.5, "val": 0.25, "test": 0.25}
    assert set(kept({}, "ac", **shares).values()) == {"train"}
    assert "none of 2 scenes is in test, val" in caplog.text
    assert kept({"a": {"val"}, "b": {"train"}}, "ac", **shares) == {"a": "val", "c": "train"}
    assert "1 scene kept where the journal has it" in caplog.text


def test_a_picture_goes_with_the_recorded_ones_of_its_scene():
    shares = {"train": 0.5, "test": 0.5, "scene": "?#"}
    jobs = [job(name, **shares) for name in ("a1", "a2")]
    for split in ("train", "test"):
        assert {each.split.name for each in with_recorded(jobs, {"a1": {split}})} == {split}


@pytest.mark.parametrize("recorded", [{"old"}, {"train", "test"}])
def test_a_split_that_is_none_any_more_or_leaks_is_given_up_and_said(recorded, caplog):
    assert kept({"a": recorded}, "a", train=0.9, test=0.1) == assigned("a", train=0.9, test=0.1)
    assert "1 scene in another split than before" in caplog.text


def test_the_frames_of_a_shot_share_their_split():
    shots = [picture(f"{name}.{n}", n) for name in ("a", "b") for n in range(9)]
    found = splits(*shots, train=0.5, test=0.5)
    assert (len(set(found[:9])), len(set(found[9:]))) == (1, 1)


def test_a_pattern_says_what_a_scene_is():
    pictures = [picture(f"{scene}_{n}") for n in range(9) for scene in "ab"]
    found = splits(*pictures, train=0.5, test=0.5, scene="*_#")
    assert [split.name for split in found] == ["train", "test"] * 9
    for scene, name in (("*_#", "x"), ("*_##", "x_1"), ("*#", "12"), ("[ab]_#", "c_1")):
        with refuses_as("no-scene scene"):
            splits(picture(name), train=1, scene=scene)
    assert assigned("a") == {"a": ""}, "without shares"


@pytest.mark.parametrize(
    ("pattern", "name", "scene"),
    [
        ("*_##", "hall_lamp_012", "hall_lamp"),
        ("*##", "hall123", "hall"),
        ("?-*-##", "a-b-c-77", "a_b-c"),
        ("take##_*", "take12_hall", "hall"),
        ("*.####", "hall.1001", "hall"),
    ],
)
def test_a_scene_is_what_wildcards_stand_for_without_the_numbers(pattern, name, scene):
    (found,) = splits(picture(name), train=1, scene=pattern)
    assert found.scene == scene


@pytest.mark.parametrize(
    ("text", "code"),
    [(r"(.+)_\d+", "malformed"), ("room", "malformed"), (r"^([^_]+)_[0-9]+$", "no-scene")],
)
def test_an_expression_and_a_pattern_without_a_wildcard_are_refused(text, code):
    with refuses(code, '"*_##"', path=Path("jobs.toml"), field="scene"):
        splits(picture("room_1"), train=1, scene=text)


def test_patterns_of_many_wildcards_end():
    with refuses_as("no-scene scene"):
        splits(picture("a" * 250), train=1, scene="*a" * 40 + "#")


def test_whole_numbers_are_so_many_scenes_and_shares_are_of_the_others():
    names = [f"s{n:02}" for n in range(30)]
    found = assigned(names, train=24, test=6)
    assert Counter(found.values()) == {"train": 24, "test": 6}
    assert found == assigned(names[::-1], train=24, test=6)
    assert Counter(assigned(names, test=6, train=1.0).values()) == {"train": 24, "test": 6}
    assert set(assigned(names, all=1).values()) == {"all"}
    with refuses("out-of-range", "30", path="jobs.toml"):
        assigned(names, train=24, test=7)
    with refuses("out-of-range", "29"):
        assigned(names, train=24, test=5)
