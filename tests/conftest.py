"""Paths, threads, and the two input files that tests of the command line share."""

import sys
from pathlib import Path

import pytest
import torch
from command_line import color_exr, depth_exr

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_scenes"))

# Small tensors gain nothing from a second thread, and lose much where the machine is busy.
torch.set_num_threads(1)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def color(tmp_path: Path) -> Path:
    return color_exr(tmp_path / "color.exr")


@pytest.fixture
def depth(tmp_path: Path) -> Path:
    return depth_exr(tmp_path / "depth.exr")
