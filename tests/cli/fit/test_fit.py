"""`defocus fit` finds the lens of a picture, and writes it for `defocus render`."""

import shutil
import tomllib

import numpy as np
import pytest
from command_line import failed, read_exr, refused, run, succeed, write_exr

from defocus_core.batch.lens_fit import words

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
    folder = tmp_path
    succeed("fit", *pair, "-o", folder / "lens.toml", "--focal-length", "50mm")
    lens = tomllib.loads((folder / "lens.toml").read_text())
    assert lens["fnumber"] == pytest.approx(1.4, rel=0.03)
    lens = ("--lens", folder / "lens.toml", "-o", folder / "again", "--exr-type", "float")
    succeed("render", *pair[:2], *lens)
    again, seen = (read_exr(path) for path in (folder / "again" / "render" / "a.exr", pair[2]))
    error = max(float(np.sqrt(np.mean((again[c] - seen[c]) ** 2))) for c in "RGB")
    assert error < 0.005


def test_it_tells_the_lens_in_words_and_in_json(pair):
    (record,) = run("fit", *pair, "--json", "--sensor-width", "24mm").json["pairs"]
    told = "\n".join(words(record))
    assert "focus 1.6" in told
    assert "residual: all " in told
    assert record["focus_m"] == pytest.approx(1.6, rel=0.02)
    # the same px of blur on a smaller sensor are a smaller circle
    assert record["fnumber"] == pytest.approx(1.4 * 36 / 24, rel=0.03)
    assert record["psnr"]["all"] > 40


def test_folders_are_fitted_picture_by_picture(pair, tmp_path):
    folder = tmp_path
    for name, path in zip(("sharp", "depth", "blurred"), pair, strict=True):
        (folder / name).mkdir()
        shutil.copy(path, folder / name / "a.exr")
    places = [folder / name for name in ("sharp", "depth", "blurred")]
    (folder / "lenses").mkdir()
    (folder / "lenses" / "a.toml").touch()
    refused(run("fit", *places, "-o", folder / "lenses"), 3, "exists", "a.toml")
    succeed("fit", *places, "-o", folder / "lenses", "--overwrite")
    assert "fnumber" in (folder / "lenses" / "a.toml").read_text()


def test_the_sensor_of_a_pair_is_written_for_render(pair, tmp_path):
    folder = tmp_path
    sensor = ("--dp-model", "smooth", "--dp-crosstalk", "0.2", "--outputs", "left,right")
    succeed("render", *pair[:2], *LENS, *sensor, "-o", folder / "dp", "--exr-type", "float")
    left, right = (folder / "dp" / side / "a.exr" for side in ("left", "right"))
    known = ("--focus", "1.6m", "--fnumber", "1.4", "--dual-pixel")
    ran = run("fit", *pair[:2], left, "--right", right, *known, "-o", folder / "dp.toml")
    assert "photodiodes smooth, crosstalk 0.2" in ran.out
    lens = tomllib.loads((folder / "dp.toml").read_text())
    assert lens["dp-crosstalk"] == pytest.approx(0.2, abs=0.01)
    assert (lens["fnumber"], lens["focus"]) == (pytest.approx(1.4), "1.6m")
    asked = ("--lens", folder / "dp.toml", "--outputs", "left", "--exr-type", "float")
    succeed("render", *pair[:2], *asked, "-o", folder / "dp2")
    again, seen = (read_exr(path) for path in (folder / "dp2" / "left" / "a.exr", left))
    assert max(float(np.abs(again[c] - seen[c]).mean()) for c in "RGB") < 1e-3


def test_a_lens_that_explains_nothing_is_written_only_if_it_is_accepted(pair, tmp_path):
    sharp, depth, seen = pair
    place = tmp_path / "no.toml"
    asked = ("fit", seen, depth, sharp, "-o", place)
    failed(run(*asked), 1, "not-explained")
    assert not place.exists()
    succeed(*asked, "--accept")
    assert place.exists()


def test_gamma_shift_and_exposure_are_found_if_asked_for(pair, tmp_path):
    folder, sharp, seen = tmp_path, read_exr(pair[0]), read_exr(pair[2])
    power = 1 / 1.4
    write_exr(folder / "s.exr", **{c: v[4:-4, 4:-4] ** power for c, v in sharp.items()})
    write_exr(folder / "b.exr", **{c: (2 * v[3:-5, 6:-2]) ** power for c, v in seen.items()})
    write_exr(folder / "d.exr", Z=read_exr(pair[1])["Z"][4:-4, 4:-4])
    files = [folder / f"{name}.exr" for name in "sdb"]
    width = ("--sensor-width", "33mm")  # of the 88 px that are left of 96
    ran = succeed("fit", *files, "--json", "--gamma", "--shift", "--exposure", *width)
    (record,) = ran.json["pairs"]
    assert record["gains"] == pytest.approx([2, 2, 2], rel=0.05)
    assert record["gamma"] == pytest.approx(1.4, rel=0.03)
    assert record["shift_px"] == pytest.approx([-2, 1], abs=0.05)
    assert record["magnification"] == pytest.approx(1, abs=1e-4)
    assert record["fnumber"] == pytest.approx(1.4, rel=0.03)
    told = "\n".join(words(record))
    assert "gamma 1." in told
    assert "px to the right" in told
    assert "magnified 1.000" in told


def test_blades_are_written_with_their_rotation(pair, tmp_path):
    folder, light = tmp_path, read_exr(pair[0])
    for pixels in light.values():
        pixels[20::32, 16::32] = 8.0  # lights show the pupil
    write_exr(folder / "l.exr", **light)
    lens = ("--focal-length", "50mm", "--fnumber", "0.7", "--focus", "1.6m", "--blades", "6")
    succeed(
        *("render", folder / "l.exr", pair[1], *lens, "--blade-rotation", "20"),
        *("-o", folder / "hex", "--exr-type", "float"),
    )
    files = (folder / "l.exr", pair[1], folder / "hex" / "render" / "l.exr")
    ran = run("fit", *files, "--blades", "0,6", "-o", folder / "hex.toml")
    assert "6 blades turned" in ran.out
    lens = tomllib.loads((folder / "hex.toml").read_text())
    assert lens["blades"] == 6
    assert lens["blade-rotation"] == pytest.approx(20, abs=3)
    assert lens["fnumber"] == pytest.approx(0.7, rel=0.03)


@pytest.mark.parametrize(
    ("more", "exit_code", "code", "at"),
    [
        (("-o", "lens.txt"), 2, "malformed", "-o"),
        (("--blades", "2"), 2, "malformed", "blades"),
        (("--focus", "50mm"), 2, "focus-too-near", "focus"),
        (("--focal-length", "2m"), 3, "focus-too-near", "a.exr"),  # it is found at 1.6 m
        (("--right", "missing.exr"), 3, "not-found", "missing.exr"),
    ],
)
def test_mistakes_are_answered_in_a_line(pair, more, exit_code, code, at):
    refused(run("fit", *pair, *more), exit_code, code, at)
