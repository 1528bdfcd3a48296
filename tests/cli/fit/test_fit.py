"""`defocus fit` finds the lens of a picture, and writes it for `defocus render`."""

import tomllib

import numpy as np
import pytest
from command_line import failed, read_exr, refused, run, succeed, write_exr

LENS = ("--focal-length", "50mm", "--fnumber", "1.4", "--focus", "1.6m", "--blades", "0")


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A sharp picture, its depth, and the picture through a lens; read only."""
    tmp_path = tmp_path_factory.mktemp("pair")
    random = np.random.default_rng(1)
    coarse = random.random((9, 12, 3)).repeat(8, 0).repeat(8, 1)
    light = (0.5 * coarse + 0.5 * random.random((72, 96, 3))).astype(np.float32)
    depth = np.linspace(4, 1.2, 72, dtype=np.float32)[:, None].repeat(96, 1)
    depth[18:36, 30:66] = 1.0
    sharp, z = tmp_path / "a.exr", tmp_path / "z.exr"
    write_exr(sharp, **{name: light[..., i] for i, name in enumerate("RGB")})
    write_exr(z, Z=depth)
    succeed("render", sharp, z, *LENS, "-o", tmp_path / "out", "--exr-type", "float")
    return sharp, z, tmp_path / "out" / "render" / "a.exr"


def test_the_lens_file_renders_the_picture_again(pair, tmp_path):
    succeed("fit", *pair, "-o", tmp_path / "lens.toml", "--focal-length", "50mm")
    lens = tomllib.loads((tmp_path / "lens.toml").read_text())
    assert lens["fnumber"] == pytest.approx(1.4, rel=0.03)
    lens = ("--lens", tmp_path / "lens.toml", "-o", tmp_path / "again", "--exr-type", "float")
    succeed("render", *pair[:2], *lens)
    again, seen = (read_exr(path) for path in (tmp_path / "again" / "render" / "a.exr", pair[2]))
    error = max(float(np.sqrt(np.mean((again[c] - seen[c]) ** 2))) for c in "RGB")
    assert error < 0.005


def test_it_tells_the_lens_in_words_and_in_json(pair):
    small = ("fit", *pair, "--sensor-width", "24mm")
    (record,), told = run(*small, "--json").json["pairs"], run(*small).out
    assert f"focus {record['focus_m']:.4g} m" in told
    assert "residual " in told
    assert record["focus_m"] == pytest.approx(1.6, rel=0.02)
    # the same px of blur on a smaller sensor are a smaller circle
    assert record["fnumber"] == pytest.approx(1.4 * 36 / 24, rel=0.03)
    assert record["psnr"] > 40


def test_the_sensor_of_a_pair_is_written_for_render(pair, tmp_path):
    sensor = ("--dp-model", "smooth", "--dp-crosstalk", "0.2", "--outputs", "left,right")
    succeed("render", *pair[:2], *LENS, *sensor, "-o", tmp_path / "dp", "--exr-type", "float")
    left, right = (tmp_path / "dp" / side / "a.exr" for side in ("left", "right"))
    sought = ("--right", right, "--dual-pixel", "--exposure", "--shift", "-o", tmp_path / "dp.toml")
    ran = succeed("fit", *pair[:2], left, *sought)
    assert "photodiodes smooth, crosstalk 0.2" in ran.out
    lens = tomllib.loads((tmp_path / "dp.toml").read_text())
    assert lens["dp-crosstalk"] == pytest.approx(0.2, abs=0.01)
    assert lens["fnumber"] == pytest.approx(1.4, rel=0.03)
    asked = ("--lens", tmp_path / "dp.toml", "--outputs", "left", "--exr-type", "float")
    succeed("render", *pair[:2], *asked, "-o", tmp_path / "dp2")
    again, seen = (read_exr(path) for path in (tmp_path / "dp2" / "left" / "a.exr", left))
    assert max(float(np.abs(again[c] - seen[c]).mean()) for c in "RGB") < 2e-3


def test_a_lens_that_explains_nothing_is_refused(pair, tmp_path):
    sharp, depth, seen = pair
    place = tmp_path / "no.toml"
    failed(run("fit", seen, depth, sharp, "-o", place), 1, "not-explained")
    assert not place.exists()


def test_lens_files_are_replaced_if_that_is_asked_for(pair, tmp_path):
    (tmp_path / "a.toml").touch()
    refused(run("fit", *pair, "-o", tmp_path / "a.toml"), 3, "exists", "a.toml")


@pytest.mark.parametrize(
    ("more", "exit_code", "code", "at"),
    [
        (("-o", "lens.txt"), 2, "malformed", "-o"),
        (("--dual-pixel",), 2, "idle-option", "dual-pixel"),
        (("--focal-length", "2m"), 3, "focus-too-near", "a.exr"),  # it is found at 1.6 m
        (("--right", "missing.exr"), 3, "not-found", "missing.exr"),
    ],
)
def test_mistakes_are_answered_in_a_line(pair, more, exit_code, code, at):
    refused(run("fit", *pair, *more), exit_code, code, at)
