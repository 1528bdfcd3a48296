"""No name that a file holds, and no link in a prepared folder, leads outside of that folder."""

import json
import os

import pytest
from batches import again
from command_line import LENS, color_exr, failed, files_under, refused, run, succeed, texture
from records import completed, pack, record
from refusals import refuses

from defocus_core import InputError
from defocus_core.batch.datasets import finished, sample_index, update
from defocus_core.batch.journal.journal import Ledger, Shard, journal_path, shards
from defocus_core.compare.pairing import RECIPE, read_recipes
from defocus_core.io.write_files import Folder, path_fault, written_whole

FOREIGN = ("../mine", "render/../../mine", "/mine", "render/..", "render//mine", "./mine", "")


def recipe_json(folder, name):
    recipe(folder, files={"render": name})
    read_recipes(folder)


def recipe(folder, **values):
    whole = {"settings": {}, "version": "0", "renderer": 1, "inputs": {}, "files": {}, **values}
    (folder / f"a{RECIPE}").write_text(json.dumps(whole))


def journal_jsonl(folder, name):
    one = record(folder / "made", "a")
    one["outputs"]["render"]["path"] = name
    journal_path(folder).write_text(2 * (json.dumps(one) + "\n"))  # the last may be torn
    Ledger(folder)


@pytest.mark.parametrize("name", [*FOREIGN, "a\0b", "\ud800", 7, None])
@pytest.mark.parametrize("form", [recipe_json, journal_jsonl])
def test_every_file_that_names_others_is_refused_with_a_foreign_path(form, name, tmp_path):
    assert path_fault(name)
    with pytest.raises(InputError):
        form(tmp_path, name)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def mine(tmp_path):
    """A file that nobody asked to be touched."""
    path = tmp_path / "home" / "mine"
    path.parent.mkdir()
    path.write_text("mine")
    return path


def test_nothing_below_a_folder_is_reached_through_a_link(tmp_path, mine):
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


def test_a_journal_that_is_a_link_or_has_a_second_name_is_never_written(folders, tmp_path, mine):
    out = tmp_path / "out"
    out.mkdir()
    (out / "journal.jsonl").symlink_to(mine)
    refused(again(folders, out), 3, "unreadable", "journal.jsonl")
    (out / "journal.jsonl").unlink()
    (out / "journal.jsonl").hardlink_to(mine)
    refused(again(folders, out), 3, "unwritable", "journal.jsonl")
    assert mine.read_text() == "mine"


def test_shards_in_a_linked_folder_are_neither_written_nor_removed(tmp_path, mine):
    tar = mine.parent / "samples-000001.tar"
    tar.write_text("mine")
    out = tmp_path / "out"
    records = [completed(out, "a")]
    (out / "shards").symlink_to(mine.parent)
    with refuses("unwritable", "symbolic link"):
        pack(out, records, 1000)
    assert names(mine.parent) == ["mine", tar.name]


def test_what_is_accepted_goes_through_no_link(tmp_path, mine):
    for name in ("render/mine", "render/a.exr"):
        color_exr(tmp_path / "new" / name, texture(8, 8))
    goldens = tmp_path / "goldens"
    goldens.mkdir()
    (goldens / "render").symlink_to(mine.parent)
    failed(run("compare", goldens, tmp_path / "new", "--accept"), 3, "unwritable")
    assert (names(mine.parent), mine.read_text()) == (["mine"], "mine")


def test_a_report_replaces_nothing_but_a_report(tmp_path):
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
        succeed("compare", picture, picture, "--html", page, "--junit", cases)
    refused(run("compare", picture, picture, "--junit", page), 3, "exists", page)
    assert (picture.read_bytes(), jobs.read_text()) == (before, "[inputs]")


def test_a_sheet_and_difference_images_replace_nothing_but_their_like(folders, tmp_path):
    rgb, depth = folders
    other = color_exr(tmp_path / "new" / "a.exr", texture(seed=9))
    out, diff = tmp_path / "out", tmp_path / "diff"
    sheet, signed = out / "contact.png", diff / "a.exr.diff.exr"
    commands = {
        sheet: ("render", *LENS, rgb, depth, "-o", out, "--contact", "1"),
        signed: ("compare", rgb, other.parent, "--diff", diff, "--only", "a.exr"),
        diff / "a.exr.diff.png": ("compare", rgb / "a.exr", other, "--diff", diff),
    }
    for theirs, words in commands.items():
        theirs.parent.mkdir(exist_ok=True)
        color_exr(theirs)
        before = theirs.read_bytes()
        refused(run(*words), 3, "exists", theirs)
        assert files_under(theirs.parent) == {theirs.name}
        assert theirs.read_bytes() == before
        theirs.unlink()
    for words in (*commands.values(), *commands.values()):
        assert run(*words).code in (0, 1)
    (rgb / signed.name).write_bytes(signed.read_bytes())  # ours, and compared
    refused(run("compare", rgb, other.parent, "--diff", rgb), 3, "replaces-input", signed.name)


def test_no_picture_of_an_opening_is_replaced_whoever_asks(folders, tmp_path):
    opening, out = tmp_path / "out" / "render" / "a.exr", tmp_path / "out"
    before = color_exr(opening, texture(8, 8)).read_bytes()
    (tmp_path / "link.exr").symlink_to(opening)
    for named in (opening, tmp_path / "link.exr"):
        words = ("--aperture-image", named, "--overwrite", "-o")
        refused(
            again(folders, out, "--outputs", "render", *words[:-1]), 3, "replaces-input", "a.exr"
        )
        refused(run("aperture", *words, opening), 3, "replaces-input", opening)
    assert opening.read_bytes() == before


def test_a_key_of_endless_parts_is_refused_before_it_is_parsed(tmp_path):
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(".".join(["a"] * 100_000) + " = 1\n")
    refused(run("batch", jobs, "-o", tmp_path / "out"), 3, "malformed", jobs)


@pytest.mark.parametrize("attack", ["pipe", "link", "nested", "bytes", "foreign"])
def test_an_index_that_was_tampered_with_is_refused(attack, tmp_path, mine):
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
    assert sample_index.listed(tmp_path) is None
    assert update.withdraw(tmp_path) is None
    assert os.path.lexists(index)


def test_the_name_of_a_journal_cannot_make_a_merge_count_shards_for_ever(tmp_path):
    for name in ("1of999999999999", "3of2", "0of2", "1of2"):
        (tmp_path / f"journal-{name}.jsonl").touch()
    assert shards(tmp_path) == [Shard(1, 2)]
    assert run("merge", tmp_path, "--json").json["missing"] == ["2/2"]


@pytest.mark.parametrize(
    "words",
    [
        ("status", "journal.jsonl"),
        ("merge", "journal-1of2.jsonl"),
        ("info", "a.png"),
        ("bench", "--truth", "x/camera.json"),
    ],
)
def test_a_file_that_is_a_hole_is_refused_at_once(words, here):
    """One of 100 GB took all memory, or a minute of a decoder that looked for its format."""
    *options, name = words
    (here / name).parent.mkdir(exist_ok=True)
    with (here / name).open("wb") as file:
        file.write(b"{")
        file.truncate(10**11)
    ran = run(*options, name if words[0] == "info" else here)
    assert (ran.code, ran.err.count("\n")) == (3, 1)
    assert "is a hole of 100000 MB" in ran.err
