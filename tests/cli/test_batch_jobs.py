"""``defocus batch`` with sweeps and draws, up to what a training script reads."""

import json

from command_line import files_under, refused, run, succeed
from jobs_files import FIXED, INPUTS, LENS, pictures

from defocus_core import samples

HIGH = '\n[machine]\nquality = "high"\n'


def batch(folder, text, *options):
    path = folder / "jobs.toml"
    path.write_text(f"[inputs]\n{INPUTS}\n{text}{HIGH}")
    return run("batch", path, "-o", folder / "out", "--processes", "1", *options)


def test_a_sweep_is_the_renders_that_it_stands_for(tmp_path):
    pictures(tmp_path)
    assert batch(tmp_path, LENS + '[sweep]\nfnumber = [2, 4]\nfocus = ["1m", "inf"]\n').code == 0
    single = ("--focal-length", "50mm", "--fnumber", "4", "--focus", "inf", "--quality", "high")
    files = (tmp_path / "a_rgb.exr", tmp_path / "a_z.exr")
    succeed("render", *files, "-o", tmp_path / "one", *single)
    swept = tmp_path / "out" / "render" / "a_f4_focusinf.exr"
    assert swept.read_bytes() == (tmp_path / "one" / "render" / "a_rgb.exr").read_bytes()
    assert len(files_under(tmp_path / "out" / "render")) == 8


def test_names_that_two_jobs_share_are_refused(tmp_path):
    pictures(tmp_path)
    files = {"color": "a_rgb.exr", "depth": "a_z.exr"}
    stems = [{**files, "stem": stem} for stem in ("a", "a_mirror0.4", "c")]
    (tmp_path / "list.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in stems))
    sweep = "lenses = [{squeeze = 2, obstruction = 0.4}, {squeeze = 2}]\n"
    path = tmp_path / "jobs.toml"
    path.write_text(f'[inputs]\nlist = "list.jsonl"\n{FIXED}[sweep]\n{sweep}')
    ran = run("batch", path, "-o", tmp_path / "out", "--dry-run")
    refused(ran, 3, "duplicate", "a_mirror0.4_squeeze2.exr")


def test_an_index_tells_of_the_lens_that_took_a_picture_last(tmp_path):
    pictures(tmp_path)
    out = tmp_path / "out"
    batch(tmp_path, LENS + 'fnumber = 2\nfocus = "2m"\n', "--shards-size", "1MB")
    index, words = out / "metadata.jsonl", ("--focal-length", "50mm", "--focus", "2m")
    first = index.read_bytes()

    def rendered(name, *more):
        color, depth = (tmp_path / f"a_{kind}.exr" for kind in ("rgb", "z"))
        if name != "a_rgb":
            color = color.rename(tmp_path / f"{name}.exr")
        lens = (*words, "--fnumber", "4", "--overwrite")
        ran = succeed("render", color, depth, "-o", out, *lens, *more)
        return ran.err

    rendered("a_rgb")
    assert index.read_bytes() == first, "another sample"
    told = rendered("a", "--quality", "high")
    assert f"{out / 'shards'}: warning: may hold other samples" in told
    assert [sample.lens.fnum for sample in samples(out)] == [4, 2]


def test_a_list_may_begin_with_a_comment(tmp_path):
    pictures(tmp_path)
    (tmp_path / "list.csv").write_text("# list.csv\ncolor,depth\na_rgb.exr,a_z.exr\n")
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(f'[inputs]\nlist = "list.csv"\n{FIXED}[outputs]\nkinds = ["coc"]\n')
    succeed("batch", jobs, "-o", tmp_path / "out")
    assert "coc/a_rgb.exr" in files_under(tmp_path / "out")
