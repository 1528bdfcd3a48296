"""Metrics are those of the renderer's own evaluation, and mean what their names say."""

import math

import numpy as np
import pytest
import torch
from image_files import save
from optional_libraries import instead
from planted_faults import HEIGHT, WIDTH, scene
from refusals import refuses

from defocus_core import compare_images
from defocus_core.compare.selection import widened
from defocus_core.evaluation import metrics as core


def measure(a, b, **options):
    return compare_images(a, b, diagnose=False, **options).metrics


def measure_pixels(*sides, **options):
    """All but the similarity, whose windows look beyond what is selected."""
    return {name: x for name, x in measure(*sides, **options).items() if name != "ssim"}


def spoiled(seed=0):
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, 3))
    return (scene() + 0.03 * noise).astype(np.float32)


def tensor(image):
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1).double()


def test_psnr_and_ssim_are_those_of_the_core():
    a, b = scene(), spoiled()
    shown, aim = core.encoded(tensor(b)), core.encoded(tensor(a))
    metrics = measure(a, b, over=0.0)
    assert metrics["psnr"] == pytest.approx(core.decibels((shown - aim).square().mean(0)), abs=1e-3)
    assert metrics["ssim"] == pytest.approx(core.ssim(core.luma(shown), core.luma(aim)), abs=1e-5)


def test_the_others_are_their_formulas():
    a, b = scene(), spoiled()
    error = np.abs(b.astype(np.float64) - a)
    metrics = measure(a, b, over=0.05)
    assert metrics["max"] == pytest.approx(error.max(), rel=1e-6)
    assert metrics["mean"] == pytest.approx(error.mean(), rel=1e-6)
    assert metrics["rmse"] == pytest.approx(math.sqrt((error**2).mean()), rel=1e-6)
    assert metrics["rel-rmse"] == pytest.approx(metrics["rmse"] / np.abs(a).mean(), rel=1e-6)
    greatest = error.max(axis=2)
    assert metrics["p99.9"] == pytest.approx(np.percentile(greatest, 99.9), rel=1e-6)
    assert metrics["share"] == (greatest > 0.05).mean()


def test_pixels_that_are_not_selected_change_nothing(tmp_path):
    a, b = scene(), spoiled()
    selected = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    selected[20:60, 10:80] = 1
    mask = save(tmp_path / "mask.png", selected)
    within = measure_pixels(a, b, mask=mask)
    assert measure_pixels(a, np.where(selected, b, np.float32(100)), mask=mask) == within
    cut = measure_pixels(a[20:60, 10:80], b[20:60, 10:80])
    assert within == pytest.approx(cut, rel=1e-7)


def test_nan_is_left_out_of_the_numbers(tmp_path):
    a, b = scene(), spoiled()
    hole = np.ones((HEIGHT, WIDTH, 1), np.uint8)
    hole[30, 40] = 0
    numbers = measure_pixels(a, np.where(hole, b, np.float32(np.nan)))
    assert numbers == measure_pixels(a, b, mask=save(tmp_path / "mask.png", hole))
    assert all(math.isfinite(value) for value in numbers.values())


def test_stored_srgb_is_not_encoded_again(tmp_path):
    stored = [(65535 * x.clip(0, 1)).astype(np.uint16) for x in (scene(), spoiled())]
    files = [save(tmp_path / f"{n}.png", x) for n, x in enumerate(stored)]
    squares = tensor(stored[1] / 65535 - stored[0] / 65535).square().mean(0)
    assert measure(*files)["psnr"] == pytest.approx(core.decibels(squares), abs=1e-3)


@pytest.mark.parametrize("reach", [0, 1, 7, 500])
def test_widening_reaches_as_far_as_it_says(reach):
    edges = np.zeros((30, 40), bool)
    edges[11:13, 17:] = edges[12:, 16:18] = True
    wide = widened(edges, reach)
    rows, columns = np.nonzero(edges)
    y, x = np.mgrid[0:30, 0:40]
    apart = np.maximum(abs(y[..., None] - rows), abs(x[..., None] - columns)).min(axis=2)
    assert np.array_equal(wide, apart <= reach)


def test_flip_without_its_library_says_what_to_install():
    a = scene()
    with instead("flip_evaluator", None), refuses("needs-extra", "defocus[flip]", field="flip"):
        measure(a, a + 1, flip=True)


@pytest.mark.parametrize("a", [0.0, 1e-7, 0.5, 3.0, 3e38])
def test_flip_of_any_light_is_a_number(a):
    pytest.importorskip("flip_evaluator")
    image = np.full((8, 8, 3), a, np.float32)
    for other in (image, image / 2, image + 2):
        assert 0.0 <= measure(image, other, flip=True)["flip"] < 1.0
    hole = image.copy()
    hole[:4] = np.nan
    assert measure(image, hole, flip=True)["flip"] == 0.0
