"""The pictures of a jobs file: patterns, folders, lists and tables, and what is wrong with them."""

import json
import os
from pathlib import Path

import pytest
from jobs_files import FIXED, PictureFiles, jobs, names, touch
from refusals import refuses

from defocus_core.io.wildcards import matching
from defocus_core.request.pairing import find_pictures


@pytest.mark.parametrize(
    ("pattern", "named"),
    [
        ("f/*.exr", {"1": "f/1.exr", "2_rgb": "f/2_rgb.exr"}),
        ("./f//*.exr", {"1": "f/1.exr", "2_rgb": "f/2_rgb.exr"}),
        ("f/*_rgb.exr", {"2": "f/2_rgb.exr"}),
        ("f/*", {"1": "f/1.exr", "2_rgb": "f/2_rgb.exr"}),
        ("s?/rgb.exr", {"1": "s1/rgb.exr", "2": "s2/rgb.exr"}),
        ("s[13]/*.exr", {"1_rgb": "s1/rgb.exr"}),
        ("**/rgb.exr", {"s1": "s1/rgb.exr", "s2": "s2/rgb.exr"}),
    ],
)
def test_wildcards_name_what_they_match(tmp_path, pattern, named):
    touch(tmp_path, "f/1.exr", "f/2_rgb.exr", "f/notes.txt", "s1/rgb.exr", "s2/rgb.exr")
    wanted = {name: tmp_path / file for name, file in named.items()}
    for folder, text in ((tmp_path, pattern), (Path("/"), f"{tmp_path}/{pattern}")):
        matches = matching(folder, text)
        assert {name: path for name, path in matches if path.suffix == ".exr"} == wanted


@pytest.mark.parametrize("closed", [".", "s1", "s1/rgb"])
def test_a_folder_that_cannot_be_looked_into_is_not_passed_over(closed, tmp_path, monkeypatch):
    touch(tmp_path, "s0/rgb/a.exr", "s1/rgb/a.exr")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path / closed)
    with refuses("unreadable"):
        list(matching(tmp_path, "*/rgb/*.exr"))
    monkeypatch.setattr(os, "access", access)
    assert len(list(matching(tmp_path, "*/rgb/*.exr"))) == 2


def test_patterns_pair_by_what_their_wildcards_stand_for(tmp_path):
    touch(tmp_path, "c/2_rgb.png", "c/1_rgb.png", "d/1.npy", "d/2.npy", "h/1.exr", "h/2.exr")
    inputs = 'color = "c/*_rgb.png"\ndepth = "d/*.npy"\nhidden-color = "h/*.exr"'
    hidden = PictureFiles("1", tmp_path / "h/1.exr", tmp_path / "h/1.exr")
    picture = PictureFiles("1", tmp_path / "c/1_rgb.png", tmp_path / "d/1.npy", hidden)
    found = jobs(tmp_path, FIXED, inputs=inputs)
    assert found[0].picture == picture
    assert names(found) == ["1", "2"]


@pytest.mark.parametrize(
    ("color", "depth", "named"),
    [
        ("scenes/s*/rgb.exr", None, ["spheres", "street"]),
        ("scenes/s*/rgb.exr", "scenes/s*/z.exr", ["spheres", "street"]),
        ("seq/frame.*.exr", "seq/frame.*.npy", ["frame.0001", "frame.0002"]),
        ("seq/frame.*.exr", "seq/z.*.npy", ["0001", "0002"]),
        ("seq/frame.00[0-9][0-9].exr", "seq/frame.00??.npy", ["frame.0001", "frame.0002"]),
    ],
)
def test_a_name_has_the_text_before_a_wildcard_that_all_patterns_share(
    tmp_path, color, depth, named
):
    touch(tmp_path, *(f"scenes/{s}/{f}.exr" for s in ("spheres", "street") for f in ("rgb", "z")))
    touch(tmp_path, *(f"seq/{f}" for i in "12" for f in (f"frame.000{i}.exr", f"frame.000{i}.npy")))
    touch(tmp_path, "seq/z.0001.npy", "seq/z.0002.npy")
    inputs = f'color = "{color}"' + (f'\ndepth = "{depth}"' if depth else "")
    assert names(jobs(tmp_path, FIXED, inputs=inputs)) == named


def test_links_that_lead_in_a_circle_are_refused(tmp_path):
    """Followed to the 40 links that the system allows, two in each folder are 2**40 paths."""
    touch(tmp_path, "a/rgb.exr", "b/rgb.exr")
    for number in (1, 2):
        (tmp_path / f"a/to_b{number}").symlink_to(tmp_path / "b")
        (tmp_path / f"b/to_a{number}").symlink_to(tmp_path / "a")
    with refuses("circular-link"):
        jobs(tmp_path, FIXED, inputs='color = "**/*.exr"')


def test_folders_and_single_files_pair_as_on_the_command_line(tmp_path):
    touch(tmp_path, "c/1.png", "d/1.npy", "b.exr", "bz.exr")
    found = jobs(tmp_path, FIXED, inputs='color = "c"\ndepth = "d"')
    assert found[0].picture == PictureFiles("1", tmp_path / "c/1.png", tmp_path / "d/1.npy")
    inputs = 'color = "c/1.png"\ndepth = "b.exr"\nhidden-color = "b.exr"\nhidden-depth = "bz.exr"'
    picture = jobs(tmp_path, FIXED, inputs=inputs)[0].picture
    assert picture.hidden == PictureFiles("b", tmp_path / "b.exr", tmp_path / "bz.exr")


def write_list(folder, kind, *rows):
    lines = [json.dumps(row) for row in rows]
    if kind == "csv":
        keys = list(dict.fromkeys(key for row in rows for key in row))
        lines = [",".join(str(row.get(key, "")) for key in keys) for row in rows]
        lines.insert(0, ",".join(keys))
    (folder / "lists").mkdir()
    (folder / "lists" / f"l.{kind}").write_text("\n".join([*lines, "", ""]), encoding="utf-8-sig")


@pytest.mark.parametrize("kind", ["csv", "jsonl"])
def test_a_list_has_a_row_for_each_picture_with_a_lens_of_its_own(tmp_path, kind):
    touch(tmp_path, "a.png", "z.exr")
    rows = [
        {"color": "../a.png", "depth": "../z.exr", "stem": 7, "focus": "3m", "blades": 6},
        {"color": "../s.exr", "hidden-color": "../h.exr"},
    ]
    write_list(tmp_path, kind, *rows)
    first, second = jobs(tmp_path, FIXED, inputs=f'list = "lists/l.{kind}"')
    folder = tmp_path / "lists"
    assert first.picture == PictureFiles("7", folder / "../a.png", folder / "../z.exr")
    assert (first.lens.foc_dist, first.lens.blades) == (3000, 6)
    assert second.picture.hidden == PictureFiles("h", folder / "../h.exr", folder / "../h.exr")
    assert (second.sample_id, second.lens.foc_dist, second.lens.blades) == ("s", 2000, 0)


def test_tables_and_lists_and_patterns_come_one_after_another(tmp_path):
    touch(tmp_path, "a.exr", "b.exr")
    (tmp_path / "l.csv").write_text("color\nb.exr\n")
    inputs = 'color = "a*.exr"\nlist = ["l.csv"]\n[[inputs.pictures]]\ncolor = "a.exr"\nstem = "c"'
    assert names(jobs(tmp_path, FIXED, inputs=inputs)) == ["a", "b", "c"]


def test_one_missing_file_of_a_list_is_left_to_its_own_job(tmp_path):
    touch(tmp_path, "b.exr")
    (tmp_path / "l.csv").write_text("color\nmissing.exr\nb.exr\n")
    assert names(jobs(tmp_path, FIXED, inputs='list = "l.csv"')) == ["missing", "b"]


@pytest.mark.parametrize("inputs", ['color = "c"\ndepth = "d"', 'color = "c/*"\ndepth = "d/*"'])
def test_pictures_without_a_file_are_refused_or_left_out(inputs, tmp_path):
    touch(tmp_path, "c/1.exr", "c/2.exr", "d/2.exr", "d/3.exr", "behind/2.exr", "behind/4.exr")
    with refuses("empty"):
        jobs(tmp_path, FIXED, inputs=inputs)
    for more in ("", f'\nhidden-color = "{"behind/*" if "*" in inputs else "behind"}"'):
        assert names(jobs(tmp_path, FIXED, inputs=f'{inputs}{more}\nmissing = "skip"')) == ["2"]
    (tmp_path / "d/2.exr").unlink()
    with refuses("empty"):
        jobs(tmp_path, FIXED, inputs=f'{inputs}\nmissing = "skip"')


def test_a_picture_may_not_bring_what_is_swept(tmp_path):
    touch(tmp_path, "b.exr")
    (tmp_path / "l.csv").write_text("color,focus-at\nb.exr,3 4\n".replace("3 4", '"3,4"'))
    sweep = FIXED.replace('focus = "2m"\n', "") + '[sweep]\nfocus = ["1m"]\n'
    with refuses("contradiction", field="focus-at"):
        jobs(tmp_path, sweep, inputs='list = "l.csv"')


def test_folders_of_other_names_are_refused(tmp_path):
    touch(tmp_path, "c/a_1.png", "c/a_2.png", "d/b_1.png", "d/b_3.png")
    with refuses("empty", "alike"):
        find_pictures(tmp_path / "c", tmp_path / "d")


def test_directories_pair_by_stem_in_order(tmp_path):
    color = touch(tmp_path / "c", "2.png", "1.JPG", ".1.png", "notes.txt")
    depth = touch(tmp_path / "d", "1.exr", "2.npy", ".hidden.exr", "readme.md")
    assert find_pictures(color, depth) == [
        PictureFiles("1", color / "1.JPG", depth / "1.exr"),
        PictureFiles("2", color / "2.png", depth / "2.npy"),
    ]


def test_a_photograph_is_depth_of_what_has_no_other(tmp_path):
    color = touch(tmp_path / "c", "1.png", "2.png")
    depth = touch(tmp_path / "d", "1.png", "1.jpg", "2.jpg", "sheet.jpg")
    assert find_pictures(color, depth) == [
        PictureFiles("1", color / "1.png", depth / "1.png"),
        PictureFiles("2", color / "2.png", depth / "2.jpg"),
    ]
    both = touch(tmp_path / "both", "1.jpg", "2.jpg", "1.npy")
    with refuses("empty"):
        find_pictures(both, both)


def test_a_file_does_not_pair_with_a_directory(tmp_path):
    folder = touch(tmp_path / "c", "1.png")
    for one, other in ((folder, folder / "1.png"), (folder / "1.png", folder)):
        with refuses("wrong-type"):
            find_pictures(one, other)
