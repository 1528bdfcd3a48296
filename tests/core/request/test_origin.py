"""A set says where it comes from: title, licence, source, citation, and its jobs file."""

import json

import pytest
from batches import jobs_file, tables
from command_line import run, succeed

from defocus_core import run_batch, samples

ABOUT = {
    "title": "Blurred | *cups* <img src=x onerror=alert(1)>\n# [x](//y)",
    "licence": "CC-BY-4.0",
    "source": "cups.org",
    "citation": "C.",
}


def as_toml(values):
    lines = []
    for name, table in values.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("by", ["file", "tables"])
def test_card_and_index_have_what_the_jobs_file_says(by, tmp_path):
    out = tmp_path / "out"
    if by == "file":
        text = as_toml(tables(tmp_path, dataset=ABOUT))
        (tmp_path / "set.toml").write_text(text)
        assert run("batch", tmp_path / "set.toml", "-o", out, "--processes", "1").code == 0
        assert (out / "jobs.toml").read_text().endswith(text)
        (tmp_path / "set.toml").unlink()
        assert run("batch", out / "jobs.toml", "-o", out, "--processes", "1").code == 0  # again
        assert run("merge", out).code == 0
    else:
        run_batch(tables(tmp_path, dataset=ABOUT), out)
    (sample,) = samples(out)
    assert (sample.record["licence"], sample.record["source"]) == ("CC-BY-4.0", "cups.org")
    card = (out / "README.md").read_text()
    title = r"# Blurred \| \*cups\* \<img src=x onerror=alert(1)\> \# \[x\](//y)"
    for told in (f"\n{title}\n", 'license: "CC-BY-4.0"', "Source: cups.org", "\nCitation: C.\n"):
        assert told in card


def test_bibtex_stands_in_the_card_as_it_is(tmp_path):
    bibtex = "@misc{cups,\n  title = {Cups *and* ```saucers```},\n}"
    run_batch(tables(tmp_path, dataset={"citation": bibtex}), tmp_path / "out")
    card = (tmp_path / "out" / "README.md").read_text()
    assert f"\n````bibtex\n{bibtex}\n````\n" in card


def test_without_a_word_there_is_none(tmp_path):
    run_batch(tables(tmp_path), tmp_path / "out")
    (sample,) = samples(tmp_path / "out")
    assert sample.record["licence"] is None
    assert "license:" not in (tmp_path / "out" / "README.md").read_text()


def test_a_file_of_others_stays(tmp_path, out):
    out.mkdir()
    (out / "jobs.toml").write_text("mine")
    assert "was not written by this batch" in succeed("batch", jobs_file(tmp_path), "-o", out).err
    assert (out / "jobs.toml").read_text() == "mine"
