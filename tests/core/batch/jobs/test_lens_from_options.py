"""A lens file is the lens options under their names; options on the command line win."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from refusals import refuses, refuses_as

from defocus_core.batch.jobs.lens_from_options import make_lens
from defocus_core.batch.lenses.lens import Lens

FLAGS = {"focal-length": 50.0, "fnumber": 2.0, "focus": 2000.0}


def lens_file(folder: Path, text: str) -> Path:
    path = folder / "lens.toml"
    path.write_text(text)
    return path


def test_a_file_and_flags_of_the_same_values_are_the_same_lens(tmp_path: Path) -> None:
    text = 'focal-length = "5cm"\nfnumber = 2\nfocus = "2m"\nblades = 6\nblade-rotation = 15\n'
    flags = {**FLAGS, "blades": 6, "blade-rotation": 15.0}
    assert make_lens({}, lens_file(tmp_path, text)) == make_lens(flags, None)


def test_a_round_aperture_cannot_be_turned(tmp_path: Path) -> None:
    with refuses("idle-option", field="blade-rotation"):
        make_lens({**FLAGS, "blade-rotation": 30.0}, None)
    with refuses("idle-option", field="blade-rotation"):
        make_lens({**FLAGS, "blades": 0, "blade-rotation": 30.0}, None)
    for text in ("blade-rotation = 30\n", "blades = 0\nblade-rotation = 30\n"):
        path = lens_file(tmp_path, text)
        with refuses("idle-option", field="blade-rotation"):
            make_lens(FLAGS, path)
        assert make_lens({**FLAGS, "blades": 5}, path).blade_rotation == 30
    with_blades = lens_file(tmp_path, "blades = 6\nblade-rotation = 30\n")
    assert make_lens({**FLAGS, "blades": 0}, with_blades).blades == 0  # the file's, switched off


def test_a_mark_that_editors_put_before_the_text_is_no_part_of_it(tmp_path: Path) -> None:
    path = tmp_path / "lens.toml"
    path.write_text('focal-length = "50mm"\n', encoding="utf-8-sig")
    assert make_lens({"fnumber": 2.0, "focus": 2000.0}, path).foclen == 50.0


def test_a_flag_wins_over_the_file(tmp_path: Path) -> None:
    path = lens_file(tmp_path, 'focal-length = "85mm"\nfnumber = 4\nfocus = inf\n')
    lens = make_lens({"fnumber": 2.0}, path)
    assert (lens.foclen, lens.fnum, lens.foc_dist) == (85.0, 2.0, math.inf)


def test_a_flag_wins_over_the_other_way_to_say_it(tmp_path: Path) -> None:
    text = 'focal-length = "50mm"\naperture-diameter = "25mm"\nfocus-at = [3, 4]\n'
    path = lens_file(tmp_path, text)
    assert make_lens({}, path) == Lens(50.0, 2.0, None, focus_at=(3, 4))
    assert make_lens({"fnumber": 8.0, "focus": 1e3}, path) == Lens(50.0, 8.0, 1e3)


def test_an_aperture_diameter_is_an_f_number() -> None:
    flags = {"focal-length": 50.0, "aperture-diameter": 25.0, "focus": 2000.0}
    assert make_lens(flags, None) == make_lens(FLAGS, None)


@pytest.mark.parametrize("missing", ["focal-length", "fnumber", "focus"])
def test_what_is_missing_is_named_with_both_ways_to_give_it(missing: str) -> None:
    flags = {name: value for name, value in FLAGS.items() if name != missing}
    with refuses("missing-option", field=missing):
        make_lens(flags, None)


@pytest.mark.parametrize(
    ("field", "more", "value"),
    [("fnumber", "aperture-diameter", 25.0), ("focus", "focus-at", (1, 1))],
)
def test_two_ways_to_say_one_thing_contradict(field: str, more: str, value: object) -> None:
    with refuses("contradiction", more, field=field):
        make_lens({**FLAGS, more: value}, None)


def test_a_file_may_not_contradict_itself(tmp_path: Path) -> None:
    path = lens_file(tmp_path, 'focal-length = "50mm"\nfnumber = 2\naperture-diameter = "25mm"\n')
    with refuses("contradiction", field="fnumber"):
        make_lens({"focus": 2000.0}, path)


@pytest.mark.parametrize("foc_dist", [49.0, 50.0])
def test_a_lens_cannot_focus_nearer_than_its_focal_length(foc_dist: float) -> None:
    with refuses("out-of-range", field="focus"):
        make_lens({**FLAGS, "focus": foc_dist}, None)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("[lens]", "unknown-name"),
        ("iso = 100", "unknown-name"),
        ("focal-length = 50", "malformed focal-length"),
        ("focus-at = [1, 2, 3]", "malformed focus-at"),
        ("blades = 2", "malformed blades"),
        ("blades = true", "malformed blades"),
    ],
)
def test_what_a_file_says_wrong_is_usage(tmp_path: Path, text: str, refusal: str) -> None:
    with refuses_as(refusal):
        make_lens(FLAGS, lens_file(tmp_path, text))


def test_a_file_that_is_not_toml_is_input_with_its_line(tmp_path: Path) -> None:
    with refuses("malformed"):
        make_lens(FLAGS, lens_file(tmp_path, "fnumber = 2\nfocus 2m\n"))


def test_a_file_that_is_not_there_is_input(tmp_path: Path) -> None:
    for path, code in ((tmp_path / "no.toml", "not-found"), (tmp_path, "unreadable")):
        with refuses(code, path=path):
            make_lens(FLAGS, path)
