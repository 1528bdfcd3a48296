"""The index of a finished batch: what training scripts find in it, and who else can read it."""

import json
import math
import tracemalloc

import pytest
from jobs_files import lens_values
from records import journal, record, write_index
from refusals import refuses

from defocus_core import samples
from defocus_core.batch.datasets import update


def written(out, *records):
    path = write_index(out, records)
    assert path == out / "metadata.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_sample_is_a_line_whose_file_name_comes_first(tmp_path):
    line = written(tmp_path, record(tmp_path, "a", ("coc", "left", "render")))[0]
    assert next(iter(line)) == "file_name"
    assert (line["file_name"], line["left_file_name"]) == ("render/a.png", "left/a.png")
    assert line["outputs"] == {"render": "render/a.png", "left": "left/a.png", "coc": "coc/a.exr"}
    assert (line["coc_min_px"], line["coc_max_px"]) == (-1, 2.5)
    assert line["inputs"] == {"color": "color.exr", "depth": "depth.exr"}


def test_a_line_says_what_was_repaired(tmp_path):
    repair = {"kinds": ["soft-edges"], "noise_px": None, "share": 0.02}
    one, other = record(tmp_path, "a", depth_repair=repair), record(tmp_path, "b")
    lines = written(tmp_path, one, other)
    assert [line["depth_repaired"] for line in lines] == [["soft-edges"], []]
    assert [line["depth_repaired_share"] for line in lines] == [0.02, None]


def test_samples_are_sorted_by_name_whatever_the_order_of_the_records(tmp_path):
    one, two = record(tmp_path, "a"), record(tmp_path, "b", ("coc",), seconds={"render": 9.0})
    failed = {**two, "status": "failed", "reason": "fault", "message": ""}
    found = written(tmp_path, two, failed, one)
    assert [line["sample_id"] for line in found] == ["a", "b"]
    assert found[1]["file_name"] == "coc/b.exr", "a map is a file, too"
    assert found == written(tmp_path, one, {**two, "seconds": {"render": 1.0}})


def test_the_index_reads_as_samples(tmp_path):
    far = {**record(tmp_path, "a")["lens"], "focus_mm": "inf", "focus_at_px": [3, 4]}
    written(tmp_path, record(tmp_path, "a"), record(tmp_path, "b", lens=far))
    first, second = samples(str(tmp_path))
    assert first.lens == lens_values()
    assert second.lens == lens_values(50.0, 2.0, math.inf, focus_at=(3, 4))
    assert first.files == {"render": tmp_path / "render/a.png", "coc": tmp_path / "coc/a.exr"}
    assert first.inputs["depth"] == tmp_path / "depth.exr"
    assert (first.size, first.coc_px, first.quality) == ((4, 3), (-1, 2.5), "high")
    assert first.record["version"] == "1"
    (tmp_path / "metadata.jsonl").write_text('{"sample_id": "a"}\n')
    with refuses("malformed", field="line 1"):
        list(samples(tmp_path))
    (tmp_path / "metadata.jsonl").unlink()
    with refuses("not-found"):
        list(samples(tmp_path))


@pytest.mark.parametrize("kinds", [("render", "coc"), ("coc",)])
def test_hugging_face_loads_a_set_without_splits(kinds, tmp_path, datasets):
    write_all(tmp_path, [record(tmp_path, name, kinds, level=10) for name in ("a", "test_b")])
    loaded = datasets.load_dataset(str(tmp_path), cache_dir=str(tmp_path / "cache"))
    assert {split: list(rows["sample_id"]) for split, rows in loaded.items()} == {
        "train": ["a", "test_b"]
    }
    assert ("image" in loaded["train"].features) == ("render" in kinds)


def write_all(out, records):
    journal(out, records)
    update.index(out, None)


def test_the_records_of_an_index_are_not_held(tmp_path):
    peaks = []
    for count in (10, 100):
        out = tmp_path / f"{count}"
        write_all(out, [record(out, f"{n:03}", split="train") for n in range(count)])
        tracemalloc.start()
        update.index(out, None)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 90 * 2000, "bytes of each; a record that is held takes 2800 more"


@pytest.fixture
def datasets():
    pytest.importorskip("PIL")
    return pytest.importorskip("datasets")
