from refusals import refuses

from defocus_core.io.shots.key_files import read_keys


def texts(folder, name, text):
    file = folder / name
    file.write_text(text)
    keys = read_keys(file)
    return {n: {frame: key.text for frame, key in each.items()} for n, each in keys.items()}


def test_columns_of_csv_are_options_and_empty_cells_no_keys(tmp_path):
    text = "# a pull\nframe,focus,focal_length,x,y\n1001,1.2m,50mm,3,4\n1005,,55mm,5,6\n"
    assert texts(tmp_path, "pull.csv", text) == {
        "focus": {1001: "1.2m"},
        "focal-length": {1001: "50mm", 1005: "55mm"},
        "focus-at": {1001: "3,4", 1005: "5,6"},
    }


def test_a_file_of_another_kind_or_none_is_refused(tmp_path):
    with refuses("not-found", path=tmp_path / "none.csv"):
        read_keys(tmp_path / "none.csv")
    with refuses("wrong-type", path=tmp_path / "pull.txt"):
        texts(tmp_path, "pull.txt", "1001 1.5\n")


def test_more_lines_than_a_shot_has_are_refused(tmp_path):
    """A million took 17 s, with their lens at each frame."""
    lines = "".join(f"{frame},2m\n" for frame in range(2**17))
    with refuses("too-large", path=tmp_path / "a.csv"):
        texts(tmp_path, "a.csv", f"frame,focus\n{lines}")


def test_a_pixel_and_its_columns_contradict_each_other(tmp_path):
    file = tmp_path / "pull.csv"
    file.write_text("frame,x,y,focus-at\n1,3,4,5,6\n".replace("5,6", '"5,6"'))
    with refuses("contradiction", field="focus-at"):
        read_keys(file)
