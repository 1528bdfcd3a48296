"""What Python users call: the names of the library, files, batches, comparison."""

import ast
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import batches
import numpy as np
import pytest
import torch
from command_line import HEIGHT, WIDTH, color_exr, ramp, run, texture
from jobs_files import Machine
from refusals import refuses

import defocus_core
from defocus_core import (
    DefocusError,
    UsageProblem,
    batch_jobs,
    compare_images,
    read_depth,
    run_batch,
    samples,
    write_image,
    write_map,
)

ROOT = Path(defocus_core.__file__).parent
ROWS = [row for names in defocus_core._GROUPS.values() for row in names.values()]
NAMES = " ".join(ROWS).split()


def tables(folder, **more):
    """The tables of a jobs file for one picture and three lenses."""
    lens = {"focal-length": "50mm", "fnumber": 2}
    return batches.tables(folder, lens=lens, sweep={"focus": ["1.5m", "2m", "3m"]}, **more)


def problem(error):
    return error.value.code, error.value.field


def test_each_name_stands_in_one_group():
    assert len(NAMES) == len(set(NAMES))
    assert sorted(NAMES) == defocus_core.__all__


def test_a_name_is_there_when_it_is_touched():
    assert all(getattr(defocus_core, name) is not None for name in NAMES)


def test_type_checkers_see_the_names_of_the_table():
    tree = ast.parse((ROOT / "__init__.py").read_text())
    (block,) = (
        n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"
    )
    seen = {
        alias.asname: statement.module
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
        if alias.asname == alias.name
    }
    assert seen == {
        name: f"defocus_core.{module}" for name, module in defocus_core._MODULE_OF.items()
    }


def test_the_help_lists_the_names_in_their_groups():
    text = run("help", "python").out
    listed = {
        group: re.findall(r"`(\w+)`", names)
        for group, names in re.findall(r"^\| ([\w ]+) \| (`.*`) \|$", text, re.M)
        if group in defocus_core._GROUPS
    }
    assert listed == {
        group: " ".join(rows.values()).split() for group, rows in defocus_core._GROUPS.items()
    }


@pytest.mark.parametrize("suffix", ["exr", "tif"])
def test_a_map_is_written_as_it_is(tmp_path, suffix):
    depth = ramp()
    depth[0, 0] = np.inf
    write_map(tmp_path / f"z.{suffix}", depth)
    np.testing.assert_array_equal(read_depth(tmp_path / f"z.{suffix}", unit="m").metres, depth)


@pytest.mark.parametrize(
    ("options", "code", "field"),
    [
        ({"format": "kity"}, "unknown-name", "depth-format"),
        ({"unit": "miles"}, "unknown-name", "depth-unit"),
        ({"kind": "distance"}, "unknown-name", "depth-kind"),
        ({"invalid": "mend"}, "unknown-name", "invalid"),
        ({"scale": 0.0}, "out-of-range", "depth-scale"),
        ({"focal_px": math.inf}, "out-of-range", "focal-px"),
        ({"fov": 180.0}, "out-of-range", "fov"),
    ],
)
def test_an_option_of_depth_that_makes_no_sense_is_named(options, code, field):
    with pytest.raises(UsageProblem) as caught:
        read_depth("z.exr", **options)
    assert problem(caught) == (code, field)
    assert f"‹{field}›" in str(caught.value)


def test_arrays_and_options_that_make_no_picture_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"pixels must be .*, got \[2, 3, 5\]"):
        write_image(tmp_path / "a.exr", np.zeros((2, 3, 5)))
    with pytest.raises(ValueError, match=r"plane must be \[H, W\], got \[2, 3, 1\]"):
        write_map(tmp_path / "a.exr", np.zeros((2, 3, 1)))
    with pytest.raises(DefocusError) as caught:
        write_map(tmp_path / "a.png", np.zeros((2, 3)))
    assert caught.value.path == str(tmp_path / "a.png")
    for field, options in (("bits", {"bits": 12}), ("jpeg-quality", {"jpeg_quality": 0})):
        with pytest.raises(DefocusError) as caught:
            write_image(tmp_path / "a.png", np.zeros((2, 3)), **options)
        assert problem(caught) == ("out-of-range", field)
    assert not list(tmp_path.iterdir())


def test_a_batch_goes_on_where_it_stopped(tmp_path, out):
    asked, ended = tables(tmp_path), []
    first = run_batch(asked, out, limit=2, ended=lambda job, record: ended.append(record.status))
    assert (first.statuses["ok"], first.skipped, first.left) == (2, 0, 1)
    assert ended == ["ok", "ok"]
    second = run_batch(asked, str(out))
    assert (second.statuses["ok"], second.skipped, second.left) == (1, 2, 0)
    found = list(samples(out))
    assert [sample.lens.foc_dist for sample in found] == [1500.0, 2000.0, 3000.0]
    coc = read_depth(found[0].files["coc"], format="coc")
    assert coc.is_radius
    assert coc.metres.shape == (HEIGHT, WIDTH)


def test_the_command_line_goes_on_with_a_batch_of_python(tmp_path, out):
    file = batches.jobs_file(tmp_path)
    assert run_batch(file, out).statuses["ok"] == 4
    assert run("batch", file, "-o", out, "--json").json["done_before"] == 4


def test_jobs_can_be_chosen_before_they_are_done(tmp_path, out):
    own, machines = Machine("high", tile=64), list[Machine]()
    every = batch_jobs(tables(tmp_path), "elsewhere")
    jobs = [replace(job, machine=own) for job in every if job.lens.foc_dist == 2000]
    ran = run_batch(jobs, out, threads=3, ended=lambda job, _: machines.append(job.machine))
    assert ran.jobs == 1
    assert machines == [replace(own, threads=3)]
    assert [sample.lens.foc_dist for sample in samples(out)] == [2000.0]
    assert not Path("elsewhere").exists()


def test_a_batch_leaves_torch_as_it_was(tmp_path, out):
    asked, interval = tables(tmp_path, outputs={"kinds": ["render"]}), sys.getswitchinterval()
    torch.set_num_threads(2)
    try:
        assert run_batch(asked, out, limit=1).statuses["ok"] == 1
        assert torch.get_num_threads() == 2
        assert sys.getswitchinterval() == interval
    finally:
        torch.set_num_threads(1)


def test_jobs_that_make_no_sense_are_refused(tmp_path, out):
    with refuses("unknown-name"):
        run_batch(tables(tmp_path, lenses={}), out)
    with pytest.raises(DefocusError) as caught:
        run_batch(tables(tmp_path), out, device="tpu")
    assert problem(caught) == ("unknown-name", "device")
    assert not out.exists()


def test_equal_pictures_pass_and_a_moved_one_is_found_out(tmp_path):
    file, pixels = color_exr(tmp_path / "a.exr"), texture().astype(np.float32)
    same = compare_images(file, pixels)
    assert same.passes
    assert same.metrics["psnr"] == 99
    moved = compare_images(pixels, torch.from_numpy(np.roll(pixels, 2, axis=1)).movedim(-1, 0))
    assert moved.status == "different"
    assert moved.findings[0].name == "shifted"
    assert moved.findings[0].values["dx"] == 2
