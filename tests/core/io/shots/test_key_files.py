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


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with refuses("not-found", path=tmp_path / "none.csv"):
        read_keys(tmp_path / "none.csv")
