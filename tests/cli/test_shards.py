"""``defocus batch --shard`` and ``merge``: parts of a batch, done by themselves, are one run."""

import pytest
from batches import contents, jobs_file, records, without_times
from command_line import refused, run, succeed

from defocus_core import run_batch


def test_a_batch_takes_over_from_shards_that_did_not_end(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out, "--shard", "1/2", "--limit", "1")
    assert "shard 1/2 did not get to its end" in run("merge", out).err
    assert run("status", out, "--json").json["left"] == 1
    succeed("batch", path, "-o", out)
    told = run("status", out, "--json").json
    assert (told["ok"], told["left"], told["jobs"], told["shards"]) == (4, 0, 4, None)


def test_shards_merged_are_one_run(tmp_path, out):
    path = jobs_file(tmp_path, *"abcde")
    run("batch", path, "-o", tmp_path / "whole")
    succeed("batch", path, "-o", out, "--shard", "1/2")
    assert run_batch(path, out, shard=(2, 2)).jobs == 4
    assert not (out / "metadata.jsonl").exists()
    journals = {f"journal-{number}of2.jsonl" for number in (1, 2)}
    assert {path.name for path in out.glob("*.jsonl")} == journals
    told = run("merge", out, "--json")
    assert told.json["jobs"] == 10
    assert told.json["missing"] == []
    assert [path.name for path in out.glob("journal*")] == ["journal.jsonl"]
    assert contents(out) == contents(tmp_path / "whole")
    assert without_times(out) == without_times(tmp_path / "whole")
    assert run("merge", out).code == 0, "once more changes nothing"
    assert run("batch", path, "-o", out).err.endswith("10 jobs: 10 done before\n")


def test_a_merge_lists_no_sample_whose_files_are_gone(tmp_path, out):
    path = jobs_file(tmp_path, *"ab")
    succeed("batch", path, "-o", out, "--shard", "1/1")
    gone, *others = sorted(out.glob("*/*.exr"))
    gone.unlink()
    ran = succeed("merge", out)
    listed = (out / "metadata.jsonl").read_text()
    assert f"lacks files of 1 sample, like {gone.stem}" in ran.err
    assert [path.name in listed for path in (gone, *others)] == [False] + [True] * len(others)


def test_shards_are_parts_of_even_size_that_share_no_picture(tmp_path, out):
    path = jobs_file(tmp_path, *"abcde")
    done = []
    for number in (1, 2, 3):
        run("batch", path, "-o", out, "--shard", f"{number}/3")
        found = records(out, f"journal-{number}of3.jsonl")
        done.append({record["settings"]["stem"] for record in found})
    assert done == [set("ad"), set("be"), set("c")]


def test_a_shard_that_is_missing_is_named(tmp_path, out):
    path = jobs_file(tmp_path, *"abc")
    run("batch", path, "-o", out, "--shard", "1/3")
    refused(
        run("batch", path, "-o", out, "--shard", "1/2"), 3, "contradiction", "journal-1of3.jsonl"
    )
    assert "1 of 3 shards begun" in run("status", out).out
    assert "warning: no journal of shards 2/3, 3/3" in run("merge", out).err
    assert run("batch", path, "-o", out).err.startswith("2 jobs done before, 4 to do")


@pytest.mark.parametrize("shard", ["0/2", "3/2", "1", "1/0", "x/y", "-1/2"])
def test_what_is_no_shard_is_refused(shard, tmp_path, out):
    ran = run("batch", jobs_file(tmp_path), "-o", out, f"--shard={shard}")
    refused(ran, 2, "malformed", "shard")
