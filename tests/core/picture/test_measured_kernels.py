"""Kernels that were measured of the photodiodes of a dual pixel."""

import numpy as np
import pytest
from batches import records
from command_line import LENS, color_exr, depth_exr, header, read_exr, refused, run, succeed
from measures import centroid

from defocus_core import samples

SIZE = (48, 72)
WIDE = ("--focal-length", "50mm", "--fnumber", "1.6", "--focus", "2m", "--sensor-width", "3mm")


@pytest.fixture
def lights(tmp_path):
    """Two lights on black beyond the focus, one on each side."""
    pixels = np.zeros((*SIZE, 3), np.float32)
    pixels[24, 14] = pixels[24, 57] = 1000.0
    depth = np.full(SIZE, 50.0, np.float32)
    return color_exr(tmp_path / "a.exr", pixels), depth_exr(tmp_path / "d.exr", depth)


def pair():
    """Left and right of a sensor that splits light less than half discs do."""
    v = np.linspace(-1, 1, 21)
    disc = (v[None] ** 2 + v[:, None] ** 2 <= 1).astype(np.float32)
    left = disc * (0.5 - 0.3 * v)
    return np.stack([left, disc - left])


def shown(folder, *args):
    succeed("render", *args, "-o", folder, *WIDE, "--exr-type", "float")
    return {file.parent.name: read_exr(file) for file in folder.glob("*/a.exr")}


def test_photodiodes_see_what_their_kernels_say(lights, tmp_path):
    np.save(tmp_path / "pair.npy", pair())
    (tmp_path / "sensor.toml").write_text('dp-model = "pair.npy"\n')
    options = (*lights, "--outputs", "render,left,right,disparity,coc")
    views = shown(tmp_path / "o", *options, "--lens", tmp_path / "sensor.toml")
    plain = shown(tmp_path / "p", *options)
    np.testing.assert_array_equal(views["render"]["G"], plain["render"]["G"])
    left, right = (centroid(views[name]["G"][:, :36])[0] for name in ("left", "right"))
    said = views["disparity"]["disparity"][24, 14]
    assert right - left == pytest.approx(said, abs=0.1)
    # a share of 0.5 - 0.3 u.x: each half is off by 0.6 of the mean square of u.x, a quarter
    assert said / views["coc"]["coc"][24, 14] == pytest.approx(2 * 0.6 / 4, rel=0.05)
    assert header(tmp_path / "o/left/a.exr")["defocus:dp_kernels"] == "pair.npy"


def test_kernels_are_inputs_of_a_batch_and_are_found_again(lights, tmp_path):
    np.save(tmp_path / "pair.npy", pair())
    np.save(tmp_path / "disc.npy", pair().sum(0))
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(
        f'[inputs]\ncolor = "{lights[0]}"\ndepth = "{lights[1]}"\n[outputs]\nkinds = ["left"]\n'
        '[lens]\nfocal-length = "50mm"\nfnumber = 2\nfocus = "2m"\naperture-image = "disc.npy"\n'
        '[sweep]\ndp-model = ["smooth", "pair.npy"]\n'
    )
    succeed("batch", jobs, "-o", tmp_path / "out", "--processes", "1")
    found = {sample.sample_id: sample for sample in samples(tmp_path / "out")}
    assert set(found) == {"a_dpsmooth", "a_dppair"}
    assert found["a_dppair"].lens.dp_kernels is not None
    assert found["a_dppair"].lens.aperture_image is not None
    record = records(tmp_path / "out")[-1]
    assert {"aperture_image", "dp_kernels"} <= record["inputs"].keys()

    before = len(records(tmp_path / "out"))
    for changed in (False, True):
        if changed:
            np.save(tmp_path / "pair.npy", pair() + 0.01)
        succeed("batch", jobs, "-o", tmp_path / "out", "--processes", "1")
        assert len(records(tmp_path / "out")) == before + changed


@pytest.mark.parametrize(
    ("option", "values", "code"),
    [
        ("--dp-model", np.ones((3, 5, 5)), "wrong-size"),
        ("--dp-model", np.ones((2, 5000, 5)), "wrong-size"),
        ("--dp-model", np.ones((2, 5, 5)), "malformed"),
    ],
)
def test_kernels_that_make_no_sense_are_refused(lights, tmp_path, option, values, code):
    np.save(tmp_path / "k.npy", values)
    out = ("-o", tmp_path / "out", "--outputs", "left")
    ran = run("render", *lights, *out, *LENS, option, tmp_path / "k.npy")
    refused(ran, 3, code, "k.npy")
    missing = run("render", *lights, *out, *LENS, option, "no.npy")
    refused(missing, 3, "not-found", "no.npy")
    assert not list((tmp_path / "out").glob("left/*"))
