"""Frames of one display window are one shot, wherever the data window of each lies."""

import numpy as np
import pytest
from command_line import succeed
from elements import write
from image_files import box

from defocus_core import read_color

HEIGHT, WIDTH, SIDE = 40, 64, 16
LENS = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "3m", "--sensor-width", "24mm")


def frame(number):
    """A square element that moves to the right, with noise in its depth."""
    rng = np.random.default_rng(number)
    planes = {name: np.zeros((HEIGHT, WIDTH), np.float32) for name in "RGBAZ"}
    inside = np.s_[12 : 12 + SIDE, 8 + 6 * number : 8 + 6 * number + SIDE]
    for k, name in enumerate("RGB"):
        planes[name][inside] = np.random.default_rng(k).random((SIDE, SIDE))
    planes["A"][inside] = 1
    planes["Z"][inside] = 2 + 0.02 * rng.standard_normal((SIDE, SIDE))
    return planes


def shot(folder, *, whole):
    folder.mkdir()
    for number in range(3):
        planes, left = frame(number), 8 + 6 * number
        data = (0, 0, WIDTH - 1, HEIGHT - 1) if whole else (left - 2, 10, left + SIDE + 1, 29)
        cut = np.s_[data[1] : data[3] + 1, data[0] : data[2] + 1]
        pieces = {name: plane[cut] for name, plane in planes.items()}
        windows = {"dataWindow": box(*data), "displayWindow": box(0, 0, WIDTH - 1, HEIGHT - 1)}
        write(folder / f"a.{number:04}.exr", pieces, **windows)
    return str(folder / "a.####.exr")


@pytest.mark.parametrize("more", [[], ["--no-steady"]])
def test_moving_data_windows_change_nothing(more, tmp_path):
    shots = {name: shot(tmp_path / name, whole=name == "whole") for name in ("whole", "moving")}
    found = {}
    for name, pattern in shots.items():
        out = tmp_path / f"{name}.out"
        succeed("render", pattern, pattern, *LENS, *more, "-o", out, "--exr-type", "float")
        files = [out / "render" / f"a.{n:04}.exr" for n in range(3)]
        found[name] = [read_color(file).pixels for file in files]
    for whole, moving in zip(found["whole"], found["moving"], strict=True):
        assert moving.shape == whole.shape
        np.testing.assert_allclose(moving, whole, atol=2e-3)
