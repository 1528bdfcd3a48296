"""What the journal has is durable; what was being written when its writer died is not there."""

import errno
import json
import os
from pathlib import Path

import pytest
from counting import calls
from records import line
from refusals import refuses

from defocus_core.batch.journal.journal import (
    Journal,
    JournalFile,
    Ledger,
    Shard,
    input_path,
    journal_path,
)
from defocus_core.batch.journal.record import line_of, record_of
from defocus_core.batch.journal.runs import gather


def record(name, status="ok", *kinds, **values):
    names = {kind: kind.split(".") for kind in kinds or ("render",)}
    outputs = {
        kind: {"path": "/".join([folder, ".".join([name, *more, "png" if more else "exr"])])}
        for kind, (folder, *more) in names.items()
    }
    told = {"status": status, "reason": None if status == "ok" else "fault", "message": ""}
    return record_of(json.dumps(line(name, outputs, **told, **values)).encode())


def write(path, *records):
    before = JournalFile(path)
    assert all(before.lines())
    with Journal(path, before.end) as journal:
        for each in records:
            journal.append(each)


def read(path):
    """The records of a journal."""
    reader = JournalFile(path)
    return [reader.record(begin) for begin in [begin for begin, *_ in reader.lines()]]


def live(out, *records):
    """What a ledger has of records."""
    write(journal_path(out), *records)
    return list(Ledger(out).records())


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


def test_a_record_that_lacks_its_newline_alone_is_whole(path):
    write(path, record("a"))
    os.truncate(path, path.stat().st_size - 1)
    assert read(path) == [record("a")]
    write(path, record("b"))
    assert read(path) == [record("a"), record("b")]


TORN = [b"\n", b'{"sample_id": "b", "sta', bytes(4), b'\0\0"status": "ok"}\n', b'{"' + b"y" * 2**18]


@pytest.mark.parametrize("torn", TORN, ids=range(len(TORN)))
def test_a_torn_tail_costs_itself_alone(torn, path):
    for before in ([], [record("a")]):
        path.unlink(missing_ok=True)
        write(path, *before)
        before_it = path.read_bytes() if before else b""
        path.write_bytes(before_it + torn)
        assert read(path) == before
        write(path, record("c"))
        assert read(path) == [*before, record("c")]


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (b"\n", b"\n{broken}\n", "line 2"),
        (b'"recipe":"2e"', b'"recipe":"\n"', "line 1"),
        (b',"status"', b',"st', 'line 1, of ü "1"'),
    ],
)
def test_a_broken_line_elsewhere_is_named_by_number_and_sample(old, new, place, path):
    write(path, record('ü "1"'), record("b"))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with refuses("damaged", place):
        read(path)


def test_a_full_disk_leaves_the_journal_as_it_was(path, monkeypatch):
    def full(number):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write(path, record("a"))
    before = path.read_bytes()
    with Journal(path, len(before)) as journal:
        monkeypatch.setattr(os, "fdatasync", full)
        with refuses("unwritable", "No space left"):
            journal.append(record("b"))
        monkeypatch.undo()
        assert path.read_bytes() == before
        journal.append(record("c"))
    assert read(path) == [record("a"), record("c")]


def test_the_last_line_holds_whatever_its_clock_said_and_shards_come_last(path):
    early, late = (f"2026-01-01T00:00:0{second}+00:00" for second in (1, 2))
    out, shard = path.parent, journal_path(path.parent, Shard(1, 2))
    write(path, record("a", finished=late, quality="high"))
    write(path, record("a", finished=early, quality="reference"), record("b", quality="high"))
    write(shard, record("b", finished=early, quality="reference"))
    before = list(Ledger(out).records())
    assert {one.quality for one in before} == {"reference"}
    copy = shard.read_bytes()
    for _ in range(2):
        assert gather(out) == [Shard(1, 2)]
        assert not shard.exists()
        assert list(Ledger(out).records()) == before
        shard.write_bytes(copy)  # as if it had been killed before that was removed
    assert list(Ledger(out).records()) == before


def test_paths_of_inputs_lead_to_them_through_linked_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("deep/jobs", "deep/rgb", "rgb", "disk", "out"):
        Path(folder).mkdir(parents=True)
    Path("jobs").symlink_to("deep/jobs")
    Path("linked").symlink_to("disk")
    assert input_path(Path("jobs/../rgb/a.exr"), Path("out")) == "../deep/rgb/a.exr"
    assert input_path(Path("rgb/../rgb/a.exr"), Path("out")) == "../rgb/a.exr"
    assert input_path(Path("linked/a.exr"), Path("out")) == "../disk/a.exr"
    assert input_path(Path("a.exr"), Path("jobs")) == "../../a.exr"


def test_the_last_record_of_a_file_holds(tmp_path):
    records = [record("a", "failed"), record("b"), record("a"), record("b", "failed")]
    found = {one.sample_id: one.status for one in live(tmp_path, *records)}
    assert found == {"a": "ok", "b": "failed"}
    ledger = Ledger(tmp_path)
    assert ledger.is_known("render/a.exr")
    assert ledger.is_known("render/b.exr"), "it was written once"
    assert not ledger.is_known("render/c.exr")


def test_a_record_holds_until_all_its_files_are_another_s(tmp_path):
    rest, last = live(tmp_path, record("a", "ok", "render", "coc"), record("a", "ok", "coc"))
    assert set(rest.outputs) == {"render"}
    assert last == record("a", "ok", "coc")
    assert len(live(tmp_path, record("a", "ok", "render"))) == 2
    assert len(live(tmp_path, record("a", "ok", "render", "coc"))) == 1


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("ok", "render", "render.preview"), ("ok",)),
        (("failed", "render", "coc"), ("failed", "coc", "disparity")),
    ],
)
def test_a_preview_alone_is_no_record_nor_what_made_nothing_and_shares_a_file(
    before, after, tmp_path
):
    records = [record("a", *before), record("a", *after)]
    assert live(tmp_path, *records) == records[1:]


def test_a_record_takes_as_much_work_among_many_as_among_few(tmp_path):
    text = line_of(record("%d", "ok", "render", "coc")).decode().strip()
    path = tmp_path / "journal.jsonl"

    def read_of(count):
        path.write_text("".join(text.replace("%d", str(i)) + "\n" for i in range(count)))
        work = calls(lambda: ledgers.append(Ledger(tmp_path)))
        assert sum(1 for _ in ledgers[-1].live()) == count
        return work

    ledgers = []
    few, many = read_of(2000), read_of(4000)
    assert few < 2000 * 250
    assert many < 2.1 * few
