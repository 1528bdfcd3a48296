from pathlib import Path

import pytest

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.shots.key_files import FIELD_OF_VIEW, read_keys


def texts(folder: Path, name: str, text: str, option: str | None = None) -> dict[str, object]:
    file = folder / name
    file.write_text(text)
    keys = read_keys(file, option)
    return {n: {frame: key.text for frame, key in each.items()} for n, each in keys.items()}


def test_columns_of_csv_are_options_and_empty_cells_no_keys(tmp_path: Path) -> None:
    text = "# a pull\nframe,focus,focal_length,x,y\n1001,1.2m,50mm,3,4\n1005,,55mm,5,6\n"
    assert texts(tmp_path, "pull.csv", text) == {
        "focus": {1001: "1.2m"},
        "focal-length": {1001: "50mm", 1005: "55mm"},
        "focus-at": {1001: "3,4", 1005: "5,6"},
    }


def test_a_curve_has_lines_of_a_frame_and_a_value(tmp_path: Path) -> None:
    for name, text in (("a.txt", "1001 1.5\n1005 2.5\n"), ("a.csv", "1001,1.5\n1005,2.5\n")):
        assert texts(tmp_path, name, text, "focus") == {"focus": {1001: "1.5", 1005: "2.5"}}
    with pytest.raises(UsageProblem, match=r"--animate focus="):
        texts(tmp_path, "a.txt", "1001 1.5\n")


def test_a_camera_of_nuke_gives_its_field_of_view(tmp_path: Path) -> None:
    lines = "1\t0 0 0\t0 0 0\t40.5\n2\t0 0 1\t0 0 0\t41\n"
    assert texts(tmp_path, "cam.chan", lines) == {FIELD_OF_VIEW: {1: "40.5", 2: "41"}}
    with pytest.raises(InputError, match="none of the lens"):
        texts(tmp_path, "old.chan", "1 0 0 0 0 0 0\n")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "has no key"),
        ("focus\n1m\n", "no column frame"),
        ("frame,focus,focus\n1,1m,1m\n", "twice"),
        ("frame,x\n1,2\n", "one of x and y"),
        ("frame,focus\n1\n", "1 cells"),
        ("frame,focus\na,1m\n", "line 2: 'a' is no frame"),
        ("frame,focus\n1,1m\n1,2m\n", "another key of frame 1"),
        ('frame,focus\n1,"1m\n', "not CSV"),
        ("\0", "no file of keys"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        texts(tmp_path, "pull.csv", text)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_keys(tmp_path / "none.csv", None)
