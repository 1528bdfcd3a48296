"""A journal may come from anywhere: each line is checked, and no file outside OUT is reached."""

import json
import re
from pathlib import Path

import pytest
from command_line import run
from records import completed, record
from refusals import refuses

import defocus_core
from defocus_core.batch.datasets import update
from defocus_core.batch.journal.journal import Ledger, journal_path
from defocus_core.batch.journal.record import Asked, Completed, Failed, line_of, record_of
from defocus_core.batch.journal.runs import open_run, run_path

WRONG = [
    ({"status": "done"}, "$.status"),
    ({"finished": "yesterday"}, "$.finished"),
    ({"finished": "2026-01-01T00:00:00"}, "timezone"),
    ({"inputs": {"depth": {"path": "z.exr"}}}, "no color"),
    ({"lens": {"fnumber": 2.0}}, "`focal_length_mm`"),
    ({"sample_id": "../a"}, "$.sample_id"),
    ({"split": "../a"}, "$.split"),
    ({"split": "train\n"}, "$.split"),
    ({"coc_px": [float("nan"), 1]}, "is broken"),
    ({"size": [0, 3]}, "$.size[0]"),
    ({"settings": {"lens": []}}, "$.lens"),
    ({"message": "\ud800"}, "is broken"),
]


def journal_of(out, *lines):
    path = journal_path(out)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_a_job_that_an_early_version_rejected_has_failed(tmp_path):
    line = {**record(tmp_path, "a"), "status": "rejected", "reason": "coc-too-large", "message": ""}
    journal_of(tmp_path, line)
    (found,) = Ledger(tmp_path).records()
    assert (found.end.status, found.end.reason) == ("failed", "coc-too-large")
    assert Ledger(tmp_path).outcomes[0].status == "failed"


def drawn(whole, **draw):
    return {**whole["lens"], "draw": {"seed": 7, "index": 0, **draw}}


def test_a_number_that_no_float_holds_and_a_seed_that_is_a_table_are_told(tmp_path):
    whole = record(tmp_path, "a")
    path = journal_of(tmp_path, whole)
    path.write_text(path.read_text().replace("2.5", "1e999"))
    with refuses("damaged", "line 1", "out of range", path=path):
        Ledger(tmp_path)
    for lens, field in (
        (drawn(whole, seed={}), "$.draw[...]"),
        ({**whole["lens"], "fnumber": "2"}, "$.fnumber"),
        ({**whole["lens"], "fnumber": None}, "no words"),
        ({**whole["lens"], "squeeze": {}}, "no words"),
        ({**whole["lens"], "focus_at_px": [1]}, "$.focus_at_px"),
    ):
        path = journal_of(tmp_path, record(tmp_path, "a", lens=lens))
        with refuses("damaged", "line 1", field, path=path):
            Ledger(tmp_path)
    journal_of(tmp_path, record(tmp_path, "a", lens=drawn(whole)))
    assert len(list(Ledger(tmp_path).records())) == 1


def test_a_line_that_lacks_a_key_is_named_by_its_number(tmp_path):
    whole = record(tmp_path, "a")
    for key in ("sample_id", "inputs", "lens", "size"):
        journal_of(tmp_path, whole, {name: whole[name] for name in whole.keys() - {key}})
        with refuses("damaged", "line 2", key):
            Ledger(tmp_path)
        assert key in run("status", tmp_path).err


def test_a_value_that_is_wrong_is_told(tmp_path):
    for change, message in WRONG:
        journal_of(tmp_path, record(tmp_path, "a", **change), record(tmp_path, "b"))
        with refuses("damaged", "line 1", message):
            Ledger(tmp_path)
    for line in (None, 3, "ok", [], [{}], {}):  # JSON that is no record, even as the last line
        journal_of(tmp_path, record(tmp_path, "a"), line)
        with refuses("damaged", "line 2"):
            Ledger(tmp_path)


def test_an_output_of_a_label_is_a_file_in_its_folder_and_of_an_input(tmp_path):
    line = record(tmp_path, "a")
    line["outputs"] |= {"masks": {"path": "masks/a.png"}}
    journal_of(tmp_path, line)
    with refuses("damaged", "not a file of a kind"):
        Ledger(tmp_path)
    line["inputs"] |= {"masks": {"path": "masks/a.png"}, "shards": {"path": "a.png"}}
    journal_of(tmp_path, line)
    assert len(list(Ledger(tmp_path).records())) == 1
    (tmp_path / "masks").symlink_to(tmp_path)
    with refuses("damaged", "masks is a link"):
        Ledger(tmp_path)
    (tmp_path / "masks").unlink()
    for path in ("masks/../a.png", "masks/b/a.png", "shards/a.png"):
        journal_of(tmp_path, {**line, "outputs": {"masks": {"path": path}}})
        with refuses("damaged"):
            Ledger(tmp_path)


def test_a_folder_of_outputs_that_is_a_link_is_refused(tmp_path):
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    journal_of(out, record(tmp_path / "made", "a", ["render"]))
    (out / "render").symlink_to(elsewhere)
    with refuses("damaged", "render is a link"):
        update.index(out, 1000)
    (out / "render").unlink()
    (out / "here").mkdir()
    (out / "render").symlink_to("here")
    with refuses("damaged", "render is a link"):
        Ledger(out)
    (out / "render").unlink()
    assert len(list(Ledger(out).records())) == 1


@pytest.mark.parametrize(
    "note", ["", "[]", "{}", '{"jobs": 1}', '{"jobs": ["a"]}', '{"jobs": {"a": "1"}}']
)
def test_a_broken_note_of_a_run_is_refused(note, tmp_path):
    run_path(tmp_path).write_text(note)
    with refuses("malformed"):
        open_run(tmp_path)


def test_the_help_has_the_table_of_fields_and_a_record_no_other(tmp_path):
    text = (Path(defocus_core.__file__).parents[1] / "defocus_cli/help/batch.md").read_text()
    fields = {name for kind in (Asked, Completed, Failed) for name in kind.__struct_fields__}
    told = re.findall(r"^\| `(\w+)` \|", text.partition("### Records")[2], re.M)
    assert {*told} == fields - {"stats", "trace", "error"}
    whole = completed(tmp_path, "a", split="train", measures={}, depth_repair=None)
    assert record_of(line_of(whole)) == whole
