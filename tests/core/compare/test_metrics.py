"""Metrics are those of the renderer's own evaluation, and mean what their names say."""

import math

import numpy as np
import pytest
import torch
from optional_libraries import instead
from planted_faults import HEIGHT, WIDTH, scene
from refusals import refuses

from defocus_core.compare.flip import measure_flip
from defocus_core.compare.metrics import measure
from defocus_core.compare.pixels import Pixels
from defocus_core.compare.selection import widened
from defocus_core.evaluation import metrics as core


def pixels(a, b, selected=None, gamma=1.0):
    split = [tuple(side[..., index] for index in range(3)) for side in (a, b)]
    return Pixels(("R", "G", "B"), *split, gamma, selected)


def spoiled(seed=0):
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, 3))
    return (scene() + 0.03 * noise).astype(np.float32)


def tensor(image):
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1).double()


def test_psnr_and_ssim_are_those_of_the_core():
    a, b = scene(), spoiled()
    shown, aim = core.encoded(tensor(b)), core.encoded(tensor(a))
    metrics = measure(pixels(a, b), over=0.0)
    assert metrics["psnr"] == pytest.approx(core.decibels((shown - aim).square().mean(0)), abs=1e-3)
    assert metrics["ssim"] == pytest.approx(core.ssim(core.luma(shown), core.luma(aim)), abs=1e-5)


def test_the_others_are_their_formulas():
    a, b = scene(), spoiled()
    error = np.abs(b.astype(np.float64) - a)
    metrics = measure(pixels(a, b), over=0.05)
    assert metrics["max"] == pytest.approx(error.max(), rel=1e-6)
    assert metrics["mean"] == pytest.approx(error.mean(), rel=1e-6)
    assert metrics["rmse"] == pytest.approx(math.sqrt((error**2).mean()), rel=1e-6)
    assert metrics["rel-rmse"] == pytest.approx(metrics["rmse"] / np.abs(a).mean(), rel=1e-6)
    greatest = error.max(axis=2)
    assert metrics["p99.9"] == pytest.approx(np.percentile(greatest, 99.9), rel=1e-6)
    assert metrics["share"] == (greatest > 0.05).mean()


def test_pixels_that_are_not_selected_change_nothing():
    a, b = scene(), spoiled()
    selected = np.zeros((HEIGHT, WIDTH), bool)
    selected[20:60, 10:80] = True
    within = measure(pixels(a, b, selected), over=0.01, asked=())
    elsewhere = np.where(selected[..., None], b, 100.0)
    assert measure(pixels(a, elsewhere, selected), over=0.01, asked=()) == within
    cut = measure(pixels(a[20:60, 10:80], b[20:60, 10:80]), over=0.01, asked=())
    assert within == pytest.approx(cut, rel=1e-7)


def test_nan_is_left_out_of_the_numbers():
    a, b = scene(), spoiled()
    hole = np.ones((HEIGHT, WIDTH), bool)
    hole[30, 40] = False
    punched = np.where(hole[..., None], b, np.nan).astype(np.float32)
    numbers = measure(pixels(a, punched), over=0.01, asked=())
    assert numbers == measure(pixels(a, b, hole), over=0.01, asked=())
    assert all(math.isfinite(value) for value in numbers.values())


def test_stored_srgb_is_not_encoded_again():
    a, b = scene().clip(0, 1), spoiled().clip(0, 1)
    metrics = measure(pixels(a, b, gamma=None), over=0.0)
    squares = tensor(b - a).square().mean(0)
    assert metrics["psnr"] == pytest.approx(core.decibels(squares), abs=1e-3)


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
        measure_flip(pixels(a, a))


@pytest.mark.parametrize("a", [0.0, 1e-7, 0.5, 3.0, 3e38])
def test_flip_of_any_light_is_a_number(a):
    pytest.importorskip("flip_evaluator")
    image = np.full((8, 8, 3), a, np.float32)
    for other in (image, image / 2, image + 2):
        assert 0.0 <= measure_flip(pixels(image, other))["flip"] < 1.0
    hole = np.ones((8, 8), bool)
    hole[:4] = False
    assert measure_flip(pixels(image, np.where(hole[..., None], image, np.nan)))["flip"] == 0.0
