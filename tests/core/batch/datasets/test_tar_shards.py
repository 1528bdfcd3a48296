"""WebDataset shards: what is in them, that they fit, and that their bytes are fixed."""

import json
import os
import tarfile

from records import completed, pack
from refusals import refuses

LARGE = 10**9


def names(path):
    with tarfile.open(path) as tar:
        return tar.getnames()


def packed(out, count, limit=LARGE):
    return pack(out, [completed(out, f"a_f1.4_s{i:03}") for i in range(count)], limit)


def test_a_sample_is_its_outputs_and_its_line_of_the_index(tmp_path):
    shard = packed(tmp_path, 2)[0]
    assert shard == tmp_path / "shards" / "samples-000000.tar"
    keys = ["a_f1_4_s000", "a_f1_4_s001"]
    wanted = [f"{key}.{kind}" for key in keys for kind in ("coc.exr", "json", "render.png")]
    assert names(shard) == wanted, "neighbours of one key, up to the first dot, are one sample"
    with tarfile.open(shard) as tar:
        data = {member.name: tar.extractfile(member).read() for member in tar}
    assert data["a_f1_4_s001.render.png"] == (tmp_path / "render/a_f1.4_s001.png").read_bytes()
    assert json.loads(data["a_f1_4_s001.json"])["sample_id"] == "a_f1.4_s001"


def test_the_bytes_depend_on_the_samples_alone(tmp_path):
    one = packed(tmp_path / "one", 3)[0]
    records = [
        completed(tmp_path / "two", f"a_f1.4_s{i:03}", seconds={"render": i}) for i in (2, 0, 1)
    ]
    os.utime(tmp_path / "two/render/a_f1.4_s001.png", (1, 1))
    two = pack(tmp_path / "two", records, LARGE)[0]
    assert one.read_bytes() == two.read_bytes()


def test_shards_hold_all_and_none_is_larger_than_it_may(tmp_path):
    limit = 30_000
    shards = packed(tmp_path, 40, limit)
    assert len(shards) > 2
    assert max(path.stat().st_size for path in shards) <= limit
    assert len(names(shards[0])) == len(names(shards[1]))
    assert sum(len(names(path)) for path in shards) == 120


def test_a_sample_that_is_too_large_has_a_shard_to_itself_and_what_is_not_needed_goes(tmp_path):
    assert [len(names(path)) for path in packed(tmp_path, 3, 1)] == [3, 3, 3]
    kept = tmp_path / "shards" / "samples-of-mine.tar"
    kept.touch()
    packed(tmp_path, 1, 1)
    left = {path.name for path in (tmp_path / "shards").iterdir()}
    assert left == {"samples-000000.tar", kept.name}


def test_a_shard_is_packed_again_only_if_something_of_it_changed(tmp_path):
    records = [completed(tmp_path, name) for name in "abc"]
    shards = pack(tmp_path, records, 1)
    for path in shards:
        os.utime(path, (1, 1))
    records[1] = completed(tmp_path, "b", level=9)
    shards[2].write_bytes(b"cut")
    pack(tmp_path, records, 1)
    assert [path.stat().st_mtime == 1 for path in shards] == [True, False, False]
    assert [len(names(path)) for path in shards] == [3, 3, 3]


def test_an_output_that_is_gone_is_told_and_no_shard_is_begun(tmp_path):
    records = [completed(tmp_path, name) for name in "ab"]
    (tmp_path / "coc" / "b.exr").unlink()
    with refuses("unreadable"):
        pack(tmp_path, records, LARGE)
    assert not list(tmp_path.glob("shards/*"))


def test_the_order_is_shuffled_by_a_seed_if_asked(tmp_path):
    sorted_names = [name for tar in packed(tmp_path, 12) for name in names(tar)]
    orders = []
    for seed in (1, 1, 2):
        (tmp_path / "jobs.toml").write_text(f"[dataset]\nshuffle = {seed}\n")
        orders.append([name for tar in packed(tmp_path, 12) for name in names(tar)])
    assert orders[0] == orders[1] != orders[2]
    assert orders[0] != sorted_names
    assert sorted(orders[0]) == sorted(orders[2]) == sorted(sorted_names)
