"""From a jobs file to a data set: what is swept and drawn is rendered, journalled and indexed."""

import json
from contextlib import suppress

import numpy as np
import pytest
import torch
from command_line import header
from command_line import run as run_command
from image_files import samples_of, to_srgb
from jobs_files import INPUTS, LENS, SAMPLE, jobs, jobs_file, pictures
from records import journalled, write_index
from refusals import refuses

from defocus_core import BatchDataset, decode_sample, run_batch, samples
from defocus_core.batch.datasets.sample_index import row_of
from defocus_core.batch.workers import pipeline, run

HIGH = '[machine]\nquality = "high"\n'


def carried_out(folder, text, name="out"):
    todo, out = jobs(folder, text + HIGH, inputs=INPUTS, out=name), folder / name
    summary = run.run(todo, out, run.Execution(pipeline.execute))
    return summary, journalled(out)


def index(folder, text):
    _, records = carried_out(folder, text)
    lines = write_index(folder / "out", records).read_text().splitlines()
    return [json.loads(line) for line in lines]


class Killed(BaseException):
    """Ends a process at once."""


def test_the_index_is_true_at_every_moment_of_a_run_that_changes_samples(tmp_path):
    pictures(tmp_path)

    drawn = SAMPLE.replace('["render", "coc"]', '["coc"]')

    def run_until(seed, killed_after):
        text = LENS + drawn.replace("seed = 7", f"seed = {seed}")
        todo, count = jobs(tmp_path, text, inputs=INPUTS), 0

        def ended(job, record):
            nonlocal count
            count += 1
            if count == killed_after:
                raise Killed

        with suppress(Killed):
            run_batch(todo, tmp_path / "out", ended=ended)

    def true_samples():
        found = list(samples(tmp_path / "out"))
        for sample in found:
            told = header(sample.files["coc"])
            assert told["defocus:fnumber"] == f"{sample.lens.fnum:.9g}"
        return len(found)

    run_until(seed=0, killed_after=0)
    assert true_samples() == 8
    for seed, killed_after in enumerate((8, 1), 1):
        run_until(seed, killed_after)
        with refuses("not-found"):
            true_samples()
    run_until(seed=5, killed_after=0)
    assert true_samples() == 8


def test_effects_are_absent_where_the_draw_says_so(tmp_path):
    pictures(tmp_path)
    effects = "noise = 'choice(off, 4000:3)'\nobstruction = 'choice(off, 0.4)'\n"
    effects += "cat-eye = 'choice(off, 1.05:1.5)'\n"
    text = LENS + "fnumber = 2\nfocus = '2m'\n[sample]\nn = 8\nseed = 1\n" + effects
    drawn = index(tmp_path, text)
    lenses = [entry["lens"] for entry in drawn]
    assert {lens["noise"] for lens in lenses} == {None, "4000:3"}
    assert {lens["obstruction"] for lens in lenses} == {0.0, 0.4}
    assert {lens["cat_eye"] for lens in lenses} == {None, "1.05:1.5"}
    assert {lens["dp_model"] for lens in lenses} == {"split"}
    assert {lens["noise_seed"] for lens in lenses} == {0}
    assert len({(lens["noise"], lens["obstruction"]) for lens in lenses}) > 2
    rows = [row_of(entry) for entry in drawn]
    types = {str({k: type(v) for k, v in (row | row["lens"]).items()}) for row in rows}
    assert len(types) == 1, "as tars and lists need it"
    read = [sample.lens.noise for sample in samples(tmp_path / "out")]
    assert read == [lens["noise"] and (4000.0, 3.0) for lens in lenses]


def read_by_samples(out):
    for each in samples(out):
        yield each.sample_id, each.record["split"], each.lens.fnum, samples_of(each.files["render"])


def read_by_torch(out):
    for split in ("train", "test"):
        for item in BatchDataset(out, split=split):
            light = item["render"].permute(1, 2, 0).numpy()
            told = np.rint(255 * to_srgb(light)).astype(np.uint8)
            yield item["sample_id"], split, float(item["lens"]["fnum"]), told


def read_by_hugging_face(out):
    pytest.importorskip("PIL")
    loader = pytest.importorskip("datasets").load_dataset
    for split, rows in loader(str(out), cache_dir=str(out.parent / "cache")).items():
        for row in rows:
            yield row["sample_id"], split, row["lens"]["fnumber"], np.asarray(row["image"])


def tars_of(out):
    return {s: sorted(map(str, (out / "shards").glob(f"{s}set-*.tar"))) for s in ("train", "test")}


def read_tars(rows):
    for row in rows:
        told = json.loads(row["json"]) if isinstance(row["json"], bytes) else row["json"]
        item = decode_sample(row)
        light = item["render"].permute(1, 2, 0).numpy()
        picture = np.rint(255 * to_srgb(light)).astype(np.uint8)
        assert torch.isfinite(item["coc"]).all()
        yield item["sample_id"], told["split"], float(item["lens"]["fnum"]), picture


def read_by_webdataset(out):
    webdataset = pytest.importorskip("webdataset", reason="needs webdataset; pip install it")
    for tars in tars_of(out).values():
        yield from read_tars(webdataset.WebDataset(tars, shardshuffle=False))


def read_tars_by_hugging_face(out):
    datasets = pytest.importorskip("datasets")
    cache = str(out.parent / "cache")
    splits = datasets.load_dataset("webdataset", data_files=tars_of(out), cache_dir=cache)
    for split in splits.values():
        yield from read_tars(split.cast_column("render.png", datasets.Image(decode=False)))


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch")
    pictures(folder)
    text = LENS + "focus = '2m'\n[sweep]\nfnumber = [2, 4]\n[split]\ntrain = 0.5\ntest = 0.5\n"
    text += "[outputs]\nkinds = ['render', 'coc']\nformat = 'png'\n"
    jobs = jobs_file(folder, text + HIGH, inputs=INPUTS)
    words = ("--processes", "1", "--threads", "1", "--shards-size", "1MB")
    assert run_command("batch", jobs, "-o", folder / "out", *words).code == 0
    return folder / "out"


@pytest.mark.parametrize(
    "read",
    [
        *(read_by_samples, read_by_torch, read_by_hugging_face),
        *(read_by_webdataset, read_tars_by_hugging_face),
    ],
)
def test_each_way_to_read_a_batch_gives_its_samples(read, batch):
    found = {name: told for name, *told in read(batch)}
    lines = map(json.loads, (batch / "metadata.jsonl").read_text().splitlines())
    wanted = {line["sample_id"]: line for line in lines}
    assert len(wanted) == 4
    assert {*found} == {*wanted}
    for name, (split, fnum, picture) in found.items():
        line = wanted[name]
        assert (split, fnum) == (line["split"], line["lens"]["fnumber"])
        assert np.array_equal(picture, samples_of(batch / line["file_name"]))
