"""No name that a file holds, and no link in a prepared folder, leads outside of that folder."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from batches import again, folders
from command_line import LENS, color_exr, failed, refused, run
from jobs_files import FIXED, INPUTS, jobs_file, pictures
from records import record
from refusals import refuses

from defocus_core.batch.datasets import finished, sample_index, tar_shards
from defocus_core.batch.journal.journal import Shard, journal_path, read_all, shards
from defocus_core.batch.journal.run_file import plan_of, run_path, sweep_up
from defocus_core.compare.goldens.store import read_store
from defocus_core.errors import InputError
from defocus_core.io.below import Folder, path_fault
from defocus_core.io.rows import read_rows
from defocus_core.io.safe_files import written_together, written_whole

__all__ = ["folders"]
FOREIGN = (
    "../mine",
    "render/../../mine",
    "/mine",
    "render/..",
    "render//mine",
    "./mine",
    "",
    "a\0b",
    "\ud800",
    7,
    None,
)


def golden_json(folder: Path, name: object) -> None:
    samples = {"a": {"files": [name], "settings": {}}}
    (folder / "golden.json").write_text(json.dumps({"samples": samples}))
    read_store(folder)


def journal_jsonl(folder: Path, name: object) -> None:
    one = record(folder / "made", "a")
    one["outputs"]["render"]["path"] = name
    journal_path(folder).write_text(json.dumps(one) + "\n")
    read_all(folder)


def run_json(folder: Path, name: object) -> None:
    plan = {"begun": "2026-01-01T00:00:00+00:00", "jobs": [[name]], "unknown": []}
    run_path(folder).write_text(json.dumps(plan))
    plan_of(folder)


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("form", [golden_json, journal_jsonl, run_json])
def test_every_file_that_names_others_is_refused_with_a_foreign_path(
    form: Any, name: object, tmp_path: Path
) -> None:
    assert path_fault(name)
    with pytest.raises(InputError):
        form(tmp_path, name)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A file that nobody asked to be touched."""
    path = tmp_path / "home" / "mine"
    path.parent.mkdir()
    path.write_text("mine")
    return path


def test_nothing_below_a_folder_is_reached_through_a_link(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "folder").symlink_to(mine.parent)
    (tmp_path / "out" / "file").symlink_to(mine)
    below = Folder(tmp_path / "out")
    for name in ("folder/mine", "file", "folder/../mine", f"{mine}"):
        for reach in (below.open, below.append, below.path):
            with pytest.raises(OSError, match=r"link|upwards|absolute"):
                reach(name)
    for name in ("folder/mine", "../home/mine"):
        with pytest.raises(OSError, match=r"link|upwards"):
            below.remove(name)
        with pytest.raises(InputError), written_whole(below.root / name, below.root) as file:
            file.write(b"theirs")
    below.remove("file")
    assert mine.read_text() == "mine"
    assert names(mine.parent) == ["mine"]


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for reach in (Folder(tmp_path).open, Folder(tmp_path).append):
        with pytest.raises(OSError, match="not a regular file"):
            reach("pipe")
    journal = journal_path(tmp_path)
    os.mkfifo(journal)
    with refuses("unreadable", "not a regular file"):
        read_all(tmp_path)


def test_a_folder_that_is_swapped_for_a_link_gets_nothing(tmp_path: Path, mine: Path) -> None:
    out = tmp_path / "out"
    with refuses("unwritable", "symbolic link"), written_together(out):
        with written_whole(out / "render" / "a.exr") as file:
            file.write(b"whole")
        (out / "render").rename(out / "moved")
        (out / "render").symlink_to(mine.parent)
        with written_whole(out / "render" / "b.exr") as file:
            file.write(b"whole")
    assert names(mine.parent) == ["mine"]
    assert names(out / "moved") == []


def test_a_journal_that_is_a_link_or_has_a_second_name_is_never_written(
    folders: tuple[Path, Path], tmp_path: Path, mine: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "journal.jsonl").symlink_to(mine)
    refused(again(folders, out), 3, "unreadable", "journal.jsonl")
    (out / "journal.jsonl").unlink()
    (out / "journal.jsonl").hardlink_to(mine)
    refused(again(folders, out), 3, "unwritable", "journal.jsonl")
    assert mine.read_text() == "mine"


def test_shards_in_a_linked_folder_are_neither_written_nor_removed(
    tmp_path: Path, mine: Path
) -> None:
    tar = mine.parent / "samples-000001.tar"
    tar.write_text("mine")
    out = tmp_path / "out"
    records = [record(out, "a")]
    (out / "shards").symlink_to(mine.parent)
    with refuses("unwritable", "symbolic link"):
        tar_shards.write(out, records, 1000)
    assert names(mine.parent) == ["mine", tar.name]


def test_half_written_files_are_not_swept_up_behind_a_link(tmp_path: Path, mine: Path) -> None:
    theirs = mine.parent / ".a.exr.99999999.0.tmp"
    theirs.touch()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "render").symlink_to(mine.parent)
    sweep_up(tmp_path / "out")
    assert theirs.exists()


def test_goldens_with_links_or_foreign_names_touch_nothing(tmp_path: Path, mine: Path) -> None:
    pictures(tmp_path)
    jobs, goldens = jobs_file(tmp_path, FIXED, inputs=INPUTS), tmp_path / "goldens"
    words = ("--processes", "1", "--threads", "1")
    goldens.mkdir()
    (goldens / "render").symlink_to(mine.parent)
    failed(run("golden", "update", jobs, goldens, "--accept", *words), 3, "unwritable")
    assert names(mine.parent) == ["mine"]
    samples = {"z": {"files": ["../home/mine"], "settings": {}}}
    (goldens / "golden.json").write_text(json.dumps({"samples": samples}))
    for command in (("update", jobs, goldens, "--accept"), ("check", jobs, goldens, "--must-fail")):
        refused(run("golden", *command, *words), 3, "damaged", "golden.json")
    assert mine.read_text() == "mine"


def test_no_goldens_notice_no_fault(tmp_path: Path) -> None:
    (tmp_path / "golden.json").write_text('{"samples": {}}')
    ran = run("golden", "check", tmp_path / "jobs.toml", tmp_path, "--must-fail")
    refused(ran, 3, "empty", tmp_path)


def test_a_report_replaces_nothing_but_a_report(tmp_path: Path) -> None:
    """Else the pictures compared, or the jobs file, are lost by a slip of the hand."""
    picture = color_exr(tmp_path / "a.exr")
    before = picture.read_bytes()
    jobs, page, cases = (tmp_path / name for name in ("jobs.toml", "a.html", "a.xml"))
    jobs.write_text("[inputs]")
    for option in ("--html", "--junit"):
        for file in (picture, jobs):
            ran = run("compare", picture, picture, option, file)
            refused(ran, 3, "exists", file)
    page.write_text("<!doctype html>\n<title>mine</title>")
    refused(run("compare", picture, picture, "--html", page), 3, "exists", page)
    page.unlink()
    for _ in range(2):
        assert run("compare", picture, picture, "--html", page, "--junit", cases).code == 0
    refused(run("compare", picture, picture, "--junit", page), 3, "exists", page)
    assert (picture.read_bytes(), jobs.read_text()) == (before, "[inputs]")


@pytest.mark.parametrize(
    "words",
    [
        ("compare", "a.exr", "b.exr", "--thresholds", "pipe.toml"),
        ("batch", "pipe.toml", "-o", "out"),
        ("render", "a.exr", "b.exr", "--lens", "pipe.toml", "-o", "out"),
        ("render", "a.exr", "b.exr", *LENS, "--animate", "pipe.csv", "-o", "out"),
    ],
)
def test_a_command_does_not_wait_for_a_pipe(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("pipe.toml", "pipe.csv"):
        os.mkfifo(tmp_path / name)
    refused(run(*words), 3, "unreadable")


def test_rows_are_read_from_no_pipe_and_columns_are_counted_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with refuses("unreadable", "not a regular file"):
        list(read_rows(tmp_path / "pipe.csv", "list", "{}"))
    (tmp_path / "wide.csv").write_text(",".join(["color"] * 100_000) + "\n")
    before = time.perf_counter()
    with refuses("duplicate", field="line 1"):
        list(read_rows(tmp_path / "wide.csv", "list", "{}"))
    assert time.perf_counter() - before < 5


def test_a_key_of_endless_parts_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(".".join(["a"] * 100_000) + " = 1\n")
    refused(run("batch", jobs, "-o", tmp_path / "out"), 3, "malformed", jobs)


@pytest.mark.parametrize(
    "samples", ["7", "[]", '{"a": {"files": 7}}', '{"a": {"files": [], "settings": 7}}', '{"a": 7}']
)
def test_wrong_types_in_golden_json_are_told(samples: str, tmp_path: Path) -> None:
    (tmp_path / "golden.json").write_text(f'{{"samples": {samples}}}')
    with pytest.raises(InputError) as caught:
        read_store(tmp_path)
    assert caught.value.code == "damaged"


def test_a_failed_record_without_a_message_is_reported(tmp_path: Path) -> None:
    failed = record(tmp_path, "a", status="failed", reason="fault", message=None)
    journal_path(tmp_path).write_text(json.dumps(failed) + "\n")
    for words in (("status", tmp_path), ("report", tmp_path)):
        ran = run(*words)
        assert "unexpected" not in ran.err, ran.err
        assert ran.code in (0, 1)


@pytest.mark.parametrize("attack", ["pipe", "link", "nested", "bytes", "foreign"])
def test_an_index_that_was_tampered_with_is_refused(
    attack: str, tmp_path: Path, mine: Path
) -> None:
    index = tmp_path / sample_index.NAME
    outputs = {"sample_id": "a", "outputs": {"render": "../home/mine"}}
    match attack:
        case "pipe":
            os.mkfifo(index)
        case "link":
            index.symlink_to(mine)
        case _:
            nested = b"[" * 200_000
            text = {"nested": nested, "bytes": b"\xff", "foreign": json.dumps(outputs).encode()}
            index.write_bytes(text[attack] + b"\n")
    with refuses("unreadable" if attack in ("pipe", "link") else "malformed"):
        list(finished.samples(tmp_path))
    assert sample_index.listed(tmp_path) == ({"a"} if attack == "foreign" else None)
    assert sample_index.withdraw(tmp_path, {"b"}, alone=True) == set()


@pytest.mark.parametrize("removed", ["[" * 200_000, "7", "null", '["../home/mine"]', '["/"]'])
def test_an_acceptance_that_was_tampered_with_removes_nothing(
    removed: str, tmp_path: Path, mine: Path
) -> None:
    aside = tmp_path / ".accepting"
    aside.mkdir()
    (aside / "golden.json").write_text('{"samples": {}}')
    (aside / "removed.json").write_text(removed)
    with refuses("unwritable"):
        read_store(tmp_path)
    assert mine.read_text() == "mine"
    assert not (tmp_path / "golden.json").exists()


def test_the_name_of_a_journal_cannot_make_a_merge_count_shards_for_ever(tmp_path: Path) -> None:
    for name in ("1of999999999999", "3of2", "0of2", "1of2"):
        (tmp_path / f"journal-{name}.jsonl").touch()
    assert shards(tmp_path) == [Shard(1, 2)]
    assert run("merge", tmp_path, "--json").json["missing"] == ["2/2"]
