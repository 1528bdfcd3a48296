"""The look of a lens in pictures of layers: elements over plates, deep pictures, holdouts."""

import numpy as np
import pytest
from batches import records
from command_line import read_exr, succeed
from deep_files import from_layers, write_deep_samples
from elements import disc, element, write

LENS = ("--focal-length", "50mm", "--fnumber", "1", "--focus", "1.5m", "--sensor-width", "9mm")
KINDS = ("over", "deep", "holdout")
SHIFT = ("--axial-color", "0.4mm:-0.3mm")


def layers():
    """A half-covered card before a background that covers all: colours, depth, coverage."""
    near, rng = disc(), np.random.default_rng(1)
    coverage = np.stack([0.75 * near, np.ones_like(near)])
    tint = rng.random((2, 3, 1, 1)).astype(np.float32)
    color = tint * coverage[:, None]
    color[1] *= rng.random(near.shape, np.float32)
    depth = np.broadcast_to(np.float32([1.2, 2.5])[:, None, None], coverage.shape)
    return color, depth, coverage


def scene(folder, kind):
    """What a command is given for the layers."""
    color, depth, coverage = layers()
    folder.mkdir(parents=True)
    if kind == "over":
        own = dict(zip("RGB", color[0], strict=True))
        plate = dict(zip("RGB", color[1], strict=True))
        own |= {"A": coverage[0], "Z": np.where(coverage[0] > 0, depth[0], 0)}
        below = write(folder / "plate.exr", plate | {"Z": depth[1]})
        return [write(folder / "a.exr", own), "--over", below]
    if kind == "deep":
        return [write_deep_samples(folder / "a.exr", from_layers(color, depth, coverage))]
    plate = dict(zip("RGBA", [*color[1], coverage[1]], strict=True))
    cut = from_layers(np.zeros_like(color[:1]), depth[:1], coverage[:1])
    file = write(folder / "a.exr", plate | {"Z": depth[1]})
    return [file, "--holdout", write_deep_samples(folder / "cut.exr", cut, light="float")]


def shown(folder, given, *options):
    """The channels of each kind of picture, as `render.R`."""
    out = folder / "out"
    succeed("render", *given, "-o", out, *LENS, "--exr-type", "float", *options)
    return {
        f"{file.parent.name}.{name}": plane
        for file in out.glob("*/a.exr")
        for name, plane in read_exr(file).items()
    }


@pytest.mark.parametrize("kind", KINDS)
def test_axial_color_moves_red_and_blue_alone(tmp_path, kind):
    plain = shown(tmp_path / "p", scene(tmp_path / "p", kind))
    axial = shown(tmp_path / "a", scene(tmp_path / "a", kind), *SHIFT)
    assert plain.keys() == axial.keys()
    np.testing.assert_array_equal(axial["render.G"], plain["render.G"])
    np.testing.assert_array_equal(axial["render.A"], plain["render.A"])
    for name in ("render.R", "render.B"):
        assert np.abs(axial[name] - plain[name]).max() > 0.02
        assert axial[name].sum() == pytest.approx(plain[name].sum(), rel=0.01)


def test_clipped_lights_of_an_element_are_brightened_and_counted(tmp_path):
    own, ones = element(disc(), (0.2, 0.2, 0.2), 1.1), np.ones((40, 60), np.float32)
    for name in "RGB":
        own[name][20:22, 30:32] = 1
    plate = dict.fromkeys("RGB", 0.1 * ones) | {"Z": 2.5 * ones}
    plate["R"][4, 50] = plate["G"][4, 50] = plate["B"][4, 50] = 1
    given = [write(tmp_path / "a.exr", own), "--over", write(tmp_path / "plate.exr", plate)]
    blurred = ("--sensor-width", "5mm")  # both lights by more than 3 px
    plain = shown(tmp_path / "p", given, *blurred)["render.G"]
    lit = shown(tmp_path / "l", given, *blurred, "--highlights", "auto")["render.G"]
    gained = lit - plain
    assert gained.sum() == pytest.approx(7 * 5, rel=0.05)
    assert gained[:10, 44:56].sum() == pytest.approx(7, rel=0.05)
    record = records(tmp_path / "l/out")[-1]
    assert "2 clipped lights brightened" in record["color_note"]
    plate["R"][0, 0] = 3.0  # measured light
    given[-1] = write(tmp_path / "bright.exr", plate)
    ran = [
        shown(tmp_path / str(k), given, *o) for k, o in enumerate([(), ("--highlights", "auto")])
    ]
    np.testing.assert_array_equal(ran[0]["render.G"], ran[1]["render.G"])
