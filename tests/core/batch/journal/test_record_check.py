"""A journal may come from anywhere: each line is checked, and no file outside OUT is reached."""

import json

import pytest
from records import record
from refusals import refuses

from defocus_core.batch.datasets import tar_shards, update
from defocus_core.batch.journal import run_file
from defocus_core.batch.journal.journal import journal_path, read, read_all
from defocus_core.batch.journal.progress import progress
from defocus_core.batch.journal.records import fault_of
from defocus_core.batch.journal.resume import Ledger, failed_jobs

NEEDED = (
    *("sample_id", "recipe", "status", "reason", "message", "settings", "inputs", "outputs"),
    *("quality", "version", "warnings", "seconds", "finished", "lens", "size", "coc_px", "device"),
)
WRONG = [
    ({"status": "done"}, "has the status 'done', not one of ok, rejected, failed"),
    ({"status": []}, "has the status [], which is of a wrong type"),
    ({"finished": "yesterday"}, "finished at 'yesterday', which is no time with a zone"),
    ({"finished": "2026-01-01T00:00:00"}, "which is no time with a zone"),
    ({"outputs": {"render": "a.png"}}, "has no path of render"),
    ({"inputs": {"depth": {"path": "z.exr"}}}, "has no colour among its inputs"),
    ({"size": [4]}, "has the size [4], not two numbers"),
    ({"coc_px": ["a", "b"]}, "not two numbers"),
    ({"seconds": {}}, "has no render"),
    ({"lens": {"fnumber": 2.0}}, "has no focal_length_mm"),
    ({"warnings": [[]]}, "has a warning that is no text"),
    ({"sample_id": "../a"}, "has a sample_id with a slash"),
    ({"coc_px": [float("nan"), 1]}, "is broken"),
]
OUTSIDE = (
    *("../../etc/passwd", "/etc/passwd", "render/../../secret", "render/..", "render", "secret"),
    *("render/", "render/sub/a.png", "./render/a.png", "secrets/a.png", "render/a\0.png", ""),
)


def journal_of(out, *lines):
    path = journal_path(out)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def output(path):
    return {"outputs": {"render": {"path": path}}}


def test_what_a_batch_writes_is_a_record(tmp_path):
    assert fault_of(record(tmp_path, "a")) is None


@pytest.mark.parametrize("key", NEEDED)
def test_a_line_that_lacks_a_key_is_named_by_its_number(key, tmp_path):
    whole = record(tmp_path, "a")
    lacking = {name: value for name, value in whole.items() if name != key}
    journal_of(tmp_path, whole, lacking)
    for command in (read_all, progress):
        with refuses("damaged", "line 2", key):
            command(tmp_path)


@pytest.mark.parametrize("line", [None, 3, "ok", [], [{}], {}])
def test_json_that_is_no_record_is_refused_even_as_the_last_line(line, tmp_path):
    path = journal_of(tmp_path, record(tmp_path, "a"), line)
    with refuses("damaged", "line 2"):
        read(path)


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_a_value_that_is_wrong_is_told(change, message, tmp_path):
    path = journal_of(tmp_path, record(tmp_path, "a", **change), record(tmp_path, "b"))
    with refuses("damaged", "line 1", message):
        read(path)


@pytest.mark.parametrize("path", OUTSIDE)
def test_an_output_that_is_no_file_of_out_is_refused(path, tmp_path):
    journal = journal_of(tmp_path, record(tmp_path, "b"), record(tmp_path, "a", **output(path)))
    with refuses("damaged", "line 2", "no file of a kind"):
        read(journal)


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
        read_all(out)
    (out / "render").unlink()
    assert len(read_all(out)) == 1


def test_a_link_in_place_of_an_output_is_not_packed(tmp_path):
    sample = record(tmp_path, "a", ["render"])
    secret = tmp_path / "secret"
    (tmp_path / "render" / "a.png").replace(secret)
    (tmp_path / "render" / "a.png").symlink_to(secret)
    with refuses("link", path=tmp_path / "render" / "a.png"):
        tar_shards.write(tmp_path, [sample], 1000)
    assert not list(tmp_path.glob("shards/*.tar"))


@pytest.mark.parametrize("stem", ["../a", "b"])
def test_settings_that_name_other_files_than_the_outputs_are_not_tried_again(stem, tmp_path):
    settings = {
        "stem": "a",
        "suffix": "",
        "lens": {"foclen": 50, "fnum": 2, "foc_dist": 1000},
        "reading": {},
        "outputs": {},
        "quality": "draft",
    }
    failed = record(tmp_path, "a", settings=settings, status="failed", **output("render/a.exr"))
    (job,) = failed_jobs(Ledger(tmp_path, [failed]), ())
    assert job.names == {"render": "render/a.exr"}
    odd = {**failed, "settings": {**settings, "stem": stem}}
    with refuses("unreadable"):
        failed_jobs(Ledger(tmp_path, [odd]), ())


PLAN = {"begun": "2026-01-01T00:00:00+00:00", "jobs": ["a"]}


@pytest.mark.parametrize(
    "plan",
    [
        "",
        "[]",
        json.dumps({"begun": PLAN["begun"]}),
        json.dumps({**PLAN, "begun": ""}),
        json.dumps({**PLAN, "begun": 5}),
        json.dumps({**PLAN, "jobs": 1}),
        json.dumps({**PLAN, "jobs": [[1]]}),
    ],
)
def test_a_broken_plan_of_a_run_is_refused(plan, tmp_path):
    run_file.run_path(tmp_path).write_text(plan)
    with refuses("malformed"):
        run_file.plan_of(tmp_path)
