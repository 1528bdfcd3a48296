"""A picture of exact depth on a CPU is rendered without torch, as it is with it."""

import subprocess
import sys

import numpy as np
import pytest
from renderers import NEEDS_LOOPS

import defocus_core as df
from defocus_core.picture import plain_path

SIZE = 96, 128
pytestmark = pytest.mark.skipif(**NEEDS_LOOPS)


def scene():
    """A card before a wall, of exact depth."""
    color = np.random.default_rng(0).random((*SIZE, 3), np.float32)
    depth = np.full(SIZE, 4, np.float32)
    depth[30:70, 40:90] = 2
    return color, depth


@pytest.mark.parametrize("options", [{}, {"blades": 5}, {"squeeze": 1.5}, {"dp_model": "smooth"}])
@pytest.mark.parametrize("left_right", [False, True])
def test_what_is_rendered_without_torch_is_what_torch_renders(options, left_right, monkeypatch):
    picture, lens = df.Picture(*scene()), df.Lens("50mm", 1.2, "2m", **options)
    views = df.render(picture, lens, left_right=left_right)
    monkeypatch.setattr(plain_path, "_views_alone", lambda take: None)
    expected = df.render(picture, lens, left_right=left_right)
    for name in ("render", "trust", *(("left", "right") if left_right else ())):
        assert np.array_equal(getattr(views, name), getattr(expected, name))


def test_a_command_imports_no_torch(tmp_path):
    color, depth = scene()
    df.write_image(tmp_path / "rgb.exr", color)
    np.save(tmp_path / "depth.npy", depth)
    words = ["render", "rgb.exr", "depth.npy", "-o", "out", "--focal-length", "50mm", "-q"]
    words += ["--fnumber", "1.2", "--focus", "2m", "--device", "cpu"]
    program = f"""
import sys
from defocus_cli.__main__ import run
sys.argv = {["defocus", *words]}
try:
    run()
except SystemExit as end:
    assert not end.code
print("torch" in sys.modules)
"""
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert ran.stdout.split()[-1] == "False"
