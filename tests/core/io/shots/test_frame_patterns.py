from pathlib import Path

import pytest
from refusals import refuses

from defocus_core import InputError, UsageProblem
from defocus_core.io.shots.frame_patterns import (
    FrameChoice,
    chosen,
    expected,
    frame_numbers,
    frames_of,
    gaps,
    in_words,
    is_pattern,
)


def touch(folder, *names):
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize("field", ["####", "%04d", "$F4", "@@@@"])
def test_a_pattern_stands_for_numbers_of_at_least_its_digits(tmp_path, field):
    touch(tmp_path, "shot.0998.exr", "shot.1001.exr", "shot.10000.exr", "shot.12.exr")
    touch(tmp_path, "shot.0998.png", "other.1001.exr", "shot.1001.exr.tmp")
    files = frames_of(tmp_path / f"shot.{field}.exr")
    wanted = {number: f"shot.{number:04}.exr" for number in (998, 1001, 10000)}
    assert {number: path.name for number, path in files.items()} == wanted


def test_negative_frames_are_not_left_out(tmp_path):
    touch(tmp_path, "s.-002.exr", "s.-0001.exr", "s.0000.exr", "s.0001.exr", "s.-1.exr")
    for name in ("s.####.exr", "s.%04d.exr"):
        assert list(frames_of(tmp_path / name)) == [-2, -1, 0, 1]
    touch(tmp_path, "t.-0001.exr")
    assert list(frames_of(tmp_path / "t.####.exr")) == [-1]


@pytest.mark.parametrize("name", ["s.%99999999999d.exr", "s.%0999d.exr", "s.####.exr"])
def test_numbers_that_no_frame_has_are_refused(name, tmp_path):
    touch(tmp_path, "s.0001.exr", "s.0002.exr", f"s.{'9' * 32}.exr")
    with pytest.raises(InputError) as caught:
        frames_of(tmp_path / name)
    assert caught.value.code == "out-of-range"


@pytest.mark.parametrize("find", [expected, gaps])
def test_a_stray_number_is_refused_before_its_gaps_are_listed(find):
    with pytest.raises(UsageProblem) as caught:
        find([1, 2, 10**9])
    assert (caught.value.code, caught.value.field) == ("out-of-range", "frames")


def test_a_file_whose_name_looks_like_a_pattern_is_a_file(tmp_path):
    touch(tmp_path, "take#2.exr")
    assert not is_pattern(tmp_path / "take#2.exr")
    assert is_pattern(tmp_path / "take#.exr")
    assert not is_pattern(tmp_path / "take.exr")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("1001-1004", (1001, 1002, 1003, 1004)), ("1-7x2, 3", (1, 3, 5, 7)), ("9,2", (2, 9))],
)
def test_lists_of_frames(text, numbers):
    assert frame_numbers(text, "--frames") == numbers


@pytest.mark.parametrize(
    ("text", "code"),
    [("", "malformed"), ("a-b", "malformed"), ("1.5", "malformed"), ("1-99999999999", "too-large")],
)
def test_what_is_no_list_of_frames_is_refused(text, code):
    with refuses(code, kind=UsageProblem):
        frame_numbers(text, "‹frames›")


def test_a_shot_on_twos_has_no_gaps_but_a_hole_is_one():
    assert gaps([1, 3, 5, 7]) == ()
    assert gaps([1, 3, 7, 9]) == (5,)
    assert gaps([1001, 1002, 1004]) == (1003,)
    assert expected([]) == ()
    assert in_words([1003, 1005, 1006]) == "3 frames, 1003, 1005-1006"


def test_missing_frames_are_an_error_that_names_them_or_are_left_out():
    color, depth = Path("c.#.exr"), Path("d.#.exr")
    files = {color: dict.fromkeys((1, 2, 3, 5), color), depth: dict.fromkeys((1, 3, 4, 5), depth)}
    with refuses("missing-frames", "1 frame, 4, d.#.exr 1 frame, 2", path=color):
        chosen(files, FrameChoice())
    numbers, skipped = chosen(files, FrameChoice(missing="skip"))
    assert numbers == (1, 3, 5)
    assert skipped == "c.#.exr lacks 1 frame, 4; d.#.exr lacks 1 frame, 2"
    assert chosen(files, FrameChoice((1, 5))) == ((1, 5), "")
    with refuses("missing-frames", "1 frame, 9"):
        chosen(files, FrameChoice((9,), "skip"))
