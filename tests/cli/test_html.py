"""``--html``: what the reports hold, and that their commands do it."""

import numpy as np
import pytest
from command_line import run, write_exr
from elements import write
from html_reports import item, items, keys
from planted_faults import planes, scene


@pytest.fixture
def folders(tmp_path):
    """Two folders: the same, shifted, missing, further, and no picture."""
    a, b = tmp_path / "A", tmp_path / "B"
    for folder, names in ((a, ("same", "shifted", "gone")), (b, ("same", "new"))):
        for name in names:
            write(folder / f"{name}.exr", planes(scene()))
    write(b / "new.exr", planes(2 * scene()))
    write(b / "shifted.exr", planes(np.roll(scene(), 2, 1)))
    for folder in (a, b):
        (folder / "bad.exr").write_bytes(b"no picture")
    return a, b


def compared(folders, *options):
    file = folders[0].parent / "report.html"
    assert run("compare", *folders, "--html", file, *options).code == 3
    return file


def test_all_pairs_are_items_with_what_they_have(folders):
    file = compared(folders)
    status = {each["name"]: each["status"] for each in items(file)}
    assert status == {
        **{"bad.exr": "unreadable", "gone.exr": "missing", "new.exr": "extra"},
        **{"same.exr": "same", "shifted.exr": "different"},
    }
    assert items(file)[-1]["name"] == "same.exr"
    shifted = item(file, "shifted.exr")
    assert shifted["words"] == "shifted by (2, 0)"
    assert keys(shifted) == ["a", "b", "difference"]
    assert keys(shifted, valued=True)[:2] == ["a", "b"]
    assert keys(item(file, "same.exr")) == ["b"]
    assert keys(item(file, "same.exr"), valued=True) == []
    assert keys(item(file, "gone.exr")) == ["a"]
    assert keys(item(file, "bad.exr")) == []


def test_values_of_eight_bits_and_of_maps_are_kept_as_they_are(tmp_path):
    radius = np.linspace(-9, 9, 600, dtype=np.float32).reshape(20, 30)
    for folder, change in (("A", 0.0), ("B", 1e-6)):
        write_exr(tmp_path / folder / "coc.exr", coc=radius + np.float32(change))
    file = tmp_path / "r.html"
    assert run("compare", tmp_path / "A", tmp_path / "B", "--html", file).code == 1
    layers = {layer["key"]: layer for layer in item(file, "coc.exr")["layers"]}
    assert layers["a"]["kind"] == "signed"
    assert layers["a"]["ends"] == pytest.approx([-9, 9])
    # Halves of A and B are equal: their difference is kept apart, in its own scale.
    assert layers["difference"]["values"]["scale"] < 1e-5
