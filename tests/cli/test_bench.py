"""``defocus bench`` on one tiny scene: a card out of focus before waves in focus."""

import json

import numpy as np
import pytest
import torch
from command_line import color_exr, depth_exr, failed, refused, run
from reference import flatten, layered, lens_points
from renderers import HAS_LOOPS
from scenes import SIZE, card_layers

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
    methods = ["sum", "standard", *["torch"] * HAS_LOOPS, "high"]
    assert [row["method"] for row in document["rows"]] == methods
    assert [mean["method"] for mean in document["means"]] == methods
    assert all(set(FIELDS) < set(row) for row in document["rows"])
    lines = ran.err.splitlines()
    assert [line.split()[2] for line in lines[1 : 1 + len(methods)]] == methods
    assert lines[1 + len(methods)].startswith("means, PSNR capped")
    psnr = {row["method"]: row["psnr"] for row in document["rows"]}
    assert psnr["standard"] > psnr["sum"] + 6
    assert all(row["seconds"] > 0 and row["fft_units"] > 0 for row in document["rows"])


def test_less_can_be_asked_for(tiny):
    ran = bench("--truth", tiny, "--quality", "reference")
    assert (ran.code, ran.err) == (0, "")
    assert [line.split()[2] for line in ran.out.splitlines()[1:3]] == ["sum", "reference"]


def test_a_missing_truth_is_named(tiny, tmp_path):
    (tmp_path / "a").mkdir()
    camera = (tiny / "card" / "camera.json").read_text()
    (tmp_path / "a" / "camera.json").write_text(camera)
    for name in ("rgb.exr", "depth.exr"):
        (tmp_path / "a" / name).symlink_to(tiny / "card" / name)
    failed(bench("--truth", tmp_path), 3, "not-found", "truth_r7.exr")


def test_a_set_must_be_named_outside_the_repository(here):
    refused(bench(), 2, "missing-option", "truth")
