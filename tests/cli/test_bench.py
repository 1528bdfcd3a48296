"""``defocus bench`` on one tiny scene: a card out of focus before waves in focus."""

import json

import numpy as np
import pytest
import torch
from command_line import color_exr, depth_exr, refused, run
from reference import flatten, layered, lens_points
from scenes import SIZE, card_layers

from defocus_core.bench import error
from defocus_core.bench.error import Row
from defocus_core.bench.timing import MeasuredCost
from defocus_core.evaluation.metrics import Errors

FIELDS = ["psnr", "psnr_edges", "psnr_elsewhere", "rel_rmse", "ssim", "p999"]


def picture(tensor):
    return np.moveaxis(tensor.float().numpy(), 0, -1)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A set of one scene of one shot, 56x40 px; the card at 2 m has a radius of -7 px."""
    root = tmp_path_factory.mktemp("truth")
    layers = card_layers(-7.0, 0.0)
    image, radius = flatten(layers, SIZE)
    metres = torch.where(radius < 0, 2.0, 4.0)
    color_exr(root / "card" / "rgb.exr", picture(image))
    depth_exr(root / "card" / "depth.exr", metres.float().numpy())
    truth = layered(layers, lens_points(24), SIZE)
    color_exr(root / "card" / "truth_r7.exr", picture(truth))
    # r = A v (1/s - 1/z) / (2 p), with s = 4 m, z = 2 m, f = 50 mm and p = 36 mm / 56
    fnumber = 50 * (50 * 4000 / 3950) * (1 / 2000 - 1 / 4000) / (2 * 7 * 36 / 56)
    shot = {"name": "r7", "fnumber": fnumber, "focus_distance_m": 4.0, "max_coc_radius_px": 7.0}
    camera = {"width": 56, "height": 40, "sensor_width_mm": 36.0, "focal_length_mm": 50.0}
    (root / "card" / "camera.json").write_text(json.dumps({**camera, "shots": [shot]}))
    return root


def bench(*args):
    return run("bench", "--threads", "1", *args)


def test_all_methods_are_measured_and_written(tiny):
    ran = bench("--truth", tiny, "--json")
    assert ran.code == 0
    document = ran.json
    methods = ["input", "sum", "over", "standard", "high"]
    assert [row["method"] for row in document["rows"]] == methods
    assert [mean["method"] for mean in document["means"]] == methods
    assert document["regressions"] == []
    assert all(set(FIELDS) < set(row) for row in document["rows"])
    lines = ran.err.splitlines()
    assert [line.split()[2] for line in lines[1:6]] == methods
    assert "means of 1 shot," in ran.err
    psnr = {row["method"]: row["psnr"] for row in document["rows"]}
    assert psnr["standard"] > max(psnr["input"], psnr["sum"], psnr["over"]) + 6
    assert all(row["seconds"] > 0 for row in document["rows"])


def test_less_can_be_asked_for(tiny):
    ran = bench("--truth", tiny, "--quality", "high")
    assert (ran.code, ran.err) == (0, "")
    methods = [line.split()[2] for line in ran.out.splitlines()[1:5]]
    assert methods == ["input", "sum", "over", "high"]


def test_a_missing_truth_is_named(tiny, tmp_path):
    (tmp_path / "a").mkdir()
    camera = (tiny / "card" / "camera.json").read_text()
    (tmp_path / "a" / "camera.json").write_text(camera)
    for name in ("rgb.exr", "depth.exr"):
        (tmp_path / "a" / name).symlink_to(tiny / "card" / name)
    refused(bench("--truth", tmp_path), 3, "missing-option", "truth_r7.exr")


def test_a_set_must_be_named_outside_the_repository(here):
    refused(bench(), 2, "missing-option", "truth")


def row(method, psnr, ssim=0.9, rel_rmse=0.1):
    errors = Errors(psnr, None, psnr, rel_rmse, ssim, 0.1)
    return Row("card", "r7", method, errors, MeasuredCost(1.0, 2.0, None))


@pytest.mark.parametrize(
    ("other", "lost"),
    [
        (row("over", 30.09), set()),
        (row("over", 30.2), {"psnr"}),
        (row("sum", 30.0, ssim=0.9012), {"ssim"}),
        (row("input", 30.0, rel_rmse=0.0985), {"rel_rmse"}),
        (row("input", 30.0, rel_rmse=0.0995), set()),
    ],
)
def test_what_a_baseline_does_better_is_flagged(other, lost):
    rows = [other, row("high", 20.0), row("standard", 30.0)]
    assert {name for r in error.regressions(rows) for name in r["lost"]} == lost
    marked = [each.method for each in rows if error.losses(each, rows)]
    assert marked == (["standard"] if lost else [])
    told = [line for line in error.summary_lines(rows) if line.startswith("! card r7")]
    assert bool(told) == bool(lost)


def test_means_cap_what_is_easy_and_leave_out_what_tells_nothing():
    easy = Row(
        "white", "r7", "standard", row("standard", 99.0).errors, MeasuredCost(1.0, 2.0, None)
    )
    smooth = Row(
        "slope", "r7", "standard", row("standard", 64.0).errors, MeasuredCost(3.0, 2.0, 7.0)
    )
    (mean,) = error.means([row("standard", 30.0), easy, smooth])
    assert (mean["shots"], mean["psnr"], mean["seconds"]) == (2, 40.0, 2.0)
    assert mean["peak_mb"] == 7.0
    assert mean["psnr_edges"] is None
