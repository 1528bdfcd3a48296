"""A finished batch as tensors: what the files hold, joined by torch's own loader."""

import errno
import itertools
import pickle
import tarfile
from pathlib import Path

import numpy as np
import pytest
import ranks
import torch
from batches import tables
from command_line import pair, read_exr, write_exr
from depth_files import png
from refusals import refuses
from torch.utils.data import DataLoader

from defocus_core import BatchDataset, decode_sample, run_batch, samples
from defocus_core.batch.datasets import tar_shards


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A batch of two pictures by two lenses, with maps in EXR."""
    folder = tmp_path_factory.mktemp("batch")
    for stem in "ab":
        pair(folder, stem)
    asked = {
        "inputs": {"color": str(folder / "rgb/*.exr"), "depth": str(folder / "depth/*.exr")},
        "split": {"train": 0.5, "test": 0.5},
        "lens": {"focal-length": "50mm", "fnumber": 2},
        "sweep": {"focus": ["1.5m", "inf"]},
        "outputs": {"kinds": ["left", "coc", "image"], "exr-type": "float"},
        "machine": {"quality": "high"},
    }
    run_batch(asked, folder / "out")
    return folder / "out"


def test_an_item_is_what_the_files_hold(out):
    data = BatchDataset(out, ["left", "coc"])
    assert len(data) == 4
    for item, sample in zip((data[n] for n in range(4)), samples(out), strict=True):
        assert item["sample_id"] == sample.sample_id
        left, coc = read_exr(sample.files["left"]), read_exr(sample.files["coc"])
        np.testing.assert_array_equal(item["left"], np.stack([left[c] for c in "RGB"]))
        np.testing.assert_array_equal(item["coc"][0], coc["coc"])
        assert item["lens"]["fnum"] == 2
        wanted = 0 if sample.lens.foc_dist == float("inf") else 1000 / sample.lens.foc_dist
        assert item["lens"]["focus_dioptres"] == pytest.approx(wanted)


def test_a_crop_says_its_place_and_has_its_own_sensor(out):
    data = BatchDataset(out, ["coc"], crop=(8, 12))
    for item, whole in zip((data[n] for n in range(4)), BatchDataset(out, ["coc"]), strict=True):
        top, left, height, width = item["place"].tolist()
        assert whole["place"].tolist() == [0, 0, *whole["coc"].shape[1:]]
        assert torch.equal(item["coc"], whole["coc"][:, top : top + height, left : left + width])
        pixel, own = (i["lens"]["sensor_width"] / i["coc"].shape[2] for i in (whole, item))
        assert own == pytest.approx(float(pixel))


def test_maps_of_tiff_are_read_too(tmp_path):
    outputs = {"kinds": ["coc"], "map-format": "tiff"}
    run_batch(tables(tmp_path, outputs=outputs), tmp_path / "out")
    ends = BatchDataset(tmp_path / "out", ["coc"])[0]["coc"]
    (sample,) = samples(tmp_path / "out")
    assert (ends.min(), ends.max()) == pytest.approx(sample.coc_px, rel=1e-6)


def test_a_loader_joins_crops_alike_with_any_workers(out):
    def batches(workers, epoch=0):
        data = BatchDataset(out, ["left", "image"], crop=(8, 12), seed=5)
        data.set_epoch(epoch)
        order = {"shuffle": True, "generator": torch.Generator().manual_seed(1)}
        loader = DataLoader(data, batch_size=3, num_workers=workers, **order)
        return torch.cat([torch.cat([b["left"], b["image"]], 1) for b in loader])

    first = batches(0)
    assert first.shape == (4, 6, 8, 12)
    assert torch.equal(first, batches(2))
    assert not torch.equal(first, batches(0, epoch=1))


@pytest.mark.parametrize("options", [{}, {"num_workers": 2, "persistent_workers": True}])
def test_each_epoch_has_crops_of_its_own_that_a_seed_repeats(options, out):
    def epochs(seed, first=0):
        data = BatchDataset(out, ["left"], crop=(8, 12), seed=seed)
        data.set_epoch(first)
        loader = DataLoader(data, **options)
        return [torch.cat([batch["left"] for batch in loader]) for _ in range(3)]

    seen = epochs(5)
    assert not any(torch.equal(a, b) for a, b in itertools.combinations(seen, 2))
    assert all(map(torch.equal, seen, epochs(5)))
    assert torch.equal(seen[2], epochs(5, first=2)[0])
    assert not torch.equal(seen[0], epochs(6)[0])


def test_two_processes_of_a_training_take_no_crop_twice(out, tmp_path):
    torch.multiprocessing.spawn(ranks.train, (out, tmp_path), nprocs=2)
    told = [torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1)]
    for found in ([*map(tuple, told[0][n] + told[1][n])] for n in (0, 1)):
        assert len({place[1:] for place in found}) == 4 * len(ranks.EPOCHS)
    alone = BatchDataset(out, ["coc"], crop=1, seed=3)
    for epoch in ranks.EPOCHS:
        alone.set_epoch(epoch)
        items = [alone[n] for n in range(4)]
        places = {(epoch, item["sample_id"], *item["place"].tolist()) for item in items}
        assert places == {place for place in told[0][0] + told[1][0] if place[0] == epoch}


def test_a_split_and_a_transform(out):
    names = [
        set(BatchDataset(out, split=split, kinds=["coc"], transform=lambda i: i["sample_id"]))
        for split in ("train", "test")
    ]
    assert [len(each) for each in names] == [2, 2]
    assert not names[0] & names[1]


def refuse_link(*_):
    raise OSError(errno.EXDEV, "Invalid cross-device link")


def test_labels_are_beside_their_sample_and_cropped_with_it(tmp_path, monkeypatch):
    for number, stem in enumerate("ab"):
        color, depth = pair(tmp_path, stem)
        size = read_exr(color)["R"].shape
        labels = (np.arange(size[0] * size[1]).reshape(size) + number).astype(np.uint16)
        png(tmp_path / "masks" / f"{stem}.png", labels, np.uint16)
        floats = labels.astype("f4")
        write_exr(tmp_path / "normals" / f"{stem}.exr", X=2 * floats, Y=-floats)
    inputs = {"color": str(color.parent / "*.exr"), "depth": str(depth.parent / "*.exr")}
    inputs["carry"] = {name: str(tmp_path / name / "*") for name in ("masks", "normals")}
    asked, out = tables(tmp_path, inputs=inputs), tmp_path / "out"
    run_batch(asked, out)
    tar_shards.write(out, 10**6)
    names = set()
    for sample in samples(out):
        for name, end in (("masks", "png"), ("normals", "exr")):
            assert sample.files[name] == out / name / f"{sample.sample_id}.{end}"
            assert sample.files[name].samefile(tmp_path / name / f"{sample.sample_id[0]}.{end}")
            names.add(f"{sample.sample_id}.{name}.{end}")
    with tarfile.open(out / "shards" / "samples-000000.tar") as tar:
        assert names < {*tar.getnames()}
        rows = {m.name.partition(".")[2]: tar.extractfile(m).read() for m in tar}
    assert decode_sample(rows)["normals"].shape[0] == 2
    assert run_batch(asked, out).skipped == 2
    sample.files["masks"].unlink()
    with monkeypatch.context() as patch:  # another file system
        patch.setattr(Path, "hardlink_to", refuse_link)
        assert run_batch(asked, out).skipped == 1
    assert not sample.files["masks"].samefile(tmp_path / "masks" / "b.png")
    assert sample.files["masks"].read_bytes() == (tmp_path / "masks" / "b.png").read_bytes()
    for number, item in enumerate(BatchDataset(out, ["coc", "masks", "normals"], crop=4)):
        top, left, *_ = item["place"].tolist()
        whole = torch.arange(size[0] * size[1]).reshape(size) + number
        cut = whole[top : top + 4, left : left + 4].int()
        assert torch.equal(item["masks"], cut[None])
        assert torch.equal(item["normals"], torch.stack([2 * cut, -cut]).float())
    with refuses("replaces-input"):
        run_batch(asked, tmp_path)
    (tmp_path / "masks" / "b.png").unlink()
    with refuses("empty"):
        run_batch(asked, out)


@pytest.mark.parametrize("name", ["coc", "shards", "json", "../up", "a.b", "Masks"])
def test_a_label_is_no_kind_and_no_path(name, tmp_path):
    color, depth = pair(tmp_path, "a")
    inputs = {"color": str(color), "depth": str(depth), "carry": {name: str(color)}}
    with refuses("malformed"):
        run_batch({"inputs": inputs, "lens": {"blur": "2px", "focus": "2m"}}, tmp_path / "out")


def test_labels_are_of_pictures_named_by_patterns(tmp_path):
    inputs = {"pictures": [{"color": "a.exr"}], "carry": {"masks": "masks/*.png"}}
    with refuses("idle-option", "the rows of pictures"):
        run_batch({"inputs": inputs, "lens": {"blur": "2px", "focus": "2m"}}, tmp_path / "out")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"kinds": ["rendr"]}, "unknown-name"),
        ({"kinds": ["right"]}, "empty"),
        ({"kinds": ["left"], "split": "val"}, "empty"),
        ({"kinds": ["left"], "crop": 10_000}, "wrong-size"),
    ],
)
def test_what_is_not_there_is_said(out, options, code):
    with refuses(code):
        BatchDataset(out, **options)


def test_an_index_is_read_where_it_is_asked_for_and_not_held(out, tmp_path):
    line = (out / "metadata.jsonl").read_text().splitlines()[0]
    index = tmp_path / "metadata.jsonl"
    index.write_text("".join(line.replace("a_", f"a{n}_") + "\n" for n in range(5000)))
    data = BatchDataset(tmp_path, ["left"], split=None)
    assert len(pickle.dumps(data.samples)) < 10 * 5000, "as a worker holds them"
    assert [data.samples[n].sample_id for n in (0, 4999, -1)] == [
        sample.sample_id for sample in itertools.islice(samples(tmp_path), 0, None, 4999)
    ] + [data.samples[4999].sample_id]
    index.write_text(index.read_text() + line + "\n")
    with refuses("changed", path=index):
        data.samples[0]
