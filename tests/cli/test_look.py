"""Each option of the look of a lens shows in the picture, in a lens file and in a record."""

import numpy as np
import pytest
from batches import records
from command_line import LENS, color_exr, depth_exr, header, read_exr, refused, run, succeed
from image_files import save

SIZE = 48
# Each option of the look after what it needs, and how it stands in headers.
LOOK = {
    "blades": ((), "3"),
    "blade-rotation": (("--blades", "3"), "90deg"),
    "blade-curvature": (("--blades", "5"), "0.6"),
    "obstruction": ((), "0.5"),
    "spherical": ((), "0.7"),
    "squeeze": ((), "2.0"),
    "cat-eye": ((), "0.8:0.7"),
    "vignetting": (("--cat-eye", "0.8:0.7"), "on"),
    "axial-color": ((), "0.2mm:0.2mm"),
    "sharp-range": ((), "10m..60m"),
}
# The same of a blur in pixels, which is no lens.
BESIDE_BLUR = {name: LOOK[name] for name in ("cat-eye", "vignetting")} | {
    "axial-color": ((), "0.3:0.3")
}
BLUR = ("--blur", "12px", "--focus-value", "0")
SMALL = ("--focal-length", "50mm", "--fnumber", "1.6", "--focus", "2m", "--sensor-width", "2mm")


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """A picture of a light on black, beyond the focus."""
    folder = tmp_path_factory.mktemp("light")
    pixels = np.zeros((SIZE, SIZE, 3), np.float32)
    pixels[24, 24] = 1000.0
    depth = np.full((SIZE, SIZE), 50.0, np.float32)
    return color_exr(folder / "rgb.exr", pixels), depth_exr(folder / "depth.exr", depth)


def drawn(light, out, *options, lens=SMALL):
    """The channels of the picture."""
    succeed("render", *light, "-o", out, *lens, "--exr-type", "float", *options)
    return read_exr(out / "render" / f"{light[0].stem}.exr")


@pytest.mark.parametrize(
    ("lens", "name", "before", "value"),
    [(SMALL, name, *row) for name, row in LOOK.items()]
    + [(BLUR, name, *row) for name, row in BESIDE_BLUR.items()],
)
def test_an_option_of_the_look_shows_and_is_written_down(lens, name, before, value, tmp_path):
    pixels = np.full((SIZE, SIZE, 3), 0.01, np.float32)
    pixels[10, 36] = 1000.0
    depth = np.full((SIZE, SIZE), 50.0, np.float32)
    light = color_exr(tmp_path / "rgb.exr", pixels), depth_exr(tmp_path / "depth.exr", depth)
    plain = drawn(light, tmp_path / "plain", *before, lens=lens)
    shown = drawn(light, tmp_path / "shown", *before, f"--{name}", value, lens=lens)
    changed = max(float(np.abs(shown[c] - plain[c]).max()) for c in "RGB")
    assert changed > 0.05 * plain["G"].max()
    field = f"defocus:{name.replace('-', '_')}"
    assert header(tmp_path / "shown/render/rgb.exr")[field] == {"on": "True"}.get(value, value)
    assert header(tmp_path / "plain/render/rgb.exr").get(field) in (None, "0", "0deg")
    record = records(tmp_path / "shown")[-1]
    assert name.replace("-", "_") in "".join(record["lens"])


def test_a_lens_file_has_them_and_the_picture_lies_beside_it(light, tmp_path):
    v = np.arange(21) - 10
    picture = ((np.abs(v) < 4)[:, None] | (np.abs(v) < 4)).astype(np.uint8) * 255
    save(tmp_path / "lenses" / "cross.png", picture[..., None])
    file = tmp_path / "lenses" / "cross.toml"
    file.write_text('aperture-image = "cross.png"\nsqueeze = 1.5\n')
    from_file = drawn(light, tmp_path / "a", "--lens", str(file))["G"]
    options = ("--aperture-image", str(tmp_path / "lenses/cross.png"), "--squeeze", "1.5")
    np.testing.assert_array_equal(from_file, drawn(light, tmp_path / "b", *options)["G"])
    assert from_file[24, 24] > 0
    assert from_file[17, 19] == 0  # between the arms


def test_a_picture_that_is_no_opening_is_refused(light, tmp_path):
    whole, out, file = np.ones((4, 4)), tmp_path / "out", tmp_path / "pupil.npy"
    for values in (0 * whole, -whole, np.ones((2, 2, 5, 5))):
        np.save(file, values)
        ran = run("render", *light, "-o", out, *LENS, "--aperture-image", file)
        refused(ran, 3, "malformed", "pupil.npy")
        assert not list(out.glob("render/*"))


def test_aperture_draws_the_opening_and_the_blur_of_a_point(tmp_path):
    out = tmp_path / "kernel.exr"
    succeed("aperture", "-o", out, "--obstruction", "0.5", "--radius", "10px")
    kernel = read_exr(out)["kernel"]
    assert kernel.shape == (21, 21)
    assert kernel.sum() == pytest.approx(1, abs=1e-6)
    assert kernel[10, 10] == 0
    refused(run("aperture", "-o", out), 3, "exists", out)
    succeed("aperture", "-o", tmp_path / "a.png", "--blades", "5")
    refused(run("aperture", "-o", tmp_path / "a.jpg"), 3, "malformed", "a.jpg")
    refused(run("aperture", "-o", out, "--blur", "40px"), 2, None, "blur")
    run("aperture", "-o", out, "--overwrite", "--dp-model", "@pixel4")
    seen = read_exr(out)
    assert seen["left"] + seen["right"] == pytest.approx(2 * seen["kernel"], abs=1e-6)
    assert not np.allclose(seen["left"], seen["right"])


def test_noise_is_that_of_its_seed_and_left_and_right_have_their_own(tmp_path):
    pixels = np.full((40, 40, 3), 0.25, np.float32)
    color = color_exr(tmp_path / "a.exr", pixels)
    depth = depth_exr(tmp_path / "d.exr", np.full((40, 40), 2.0, np.float32))

    def noisy(out, *options):
        what = ("--outputs", "render,left,right", "--exr-type", "float", "--noise", "1000:2")
        succeed("render", color, depth, "-o", tmp_path / out, *LENS, *what, *options)
        return {k: read_exr(tmp_path / out / k / "a.exr")["G"] for k in ("render", "left", "right")}

    first, again, other = noisy("a"), noisy("b", "--tile", "16"), noisy("c", "--noise-seed", "1")
    for kind, electrons in (("render", 1000), ("left", 500), ("right", 500)):
        np.testing.assert_array_equal(first[kind], again[kind])
        assert np.abs(first[kind] - other[kind]).max() > 0.01
        variance = 0.25 / electrons + (2 / electrons) ** 2
        assert first[kind].var() == pytest.approx(variance, rel=0.15)
    assert abs(np.corrcoef(first["left"].ravel(), first["right"].ravel())[0, 1]) < 0.1


def test_highlights_make_a_lamp_of_8_bits_a_disc_and_leave_hdr_alone(tmp_path):
    depth = depth_exr(tmp_path / "d.exr", np.full((SIZE, SIZE), 50.0, np.float32))
    lamp = np.full((SIZE, SIZE, 3), 60, np.uint8)
    lamp[24, 24] = (255, 200, 120)
    photo = save(tmp_path / "photo.png", lamp)
    bright = np.full((SIZE, SIZE, 3), 0.05, np.float32)
    bright[24, 24] = 5.0
    hdr = color_exr(tmp_path / "hdr.exr", bright)

    def shown(color, out, *options):
        planes = drawn((color, depth), tmp_path / out, *options)
        return np.stack([planes[name] for name in "RGB"], -1)

    plain, lit = shown(photo, "plain"), shown(photo, "lit", "--highlights", "auto")
    more = shown(photo, "more", "--highlights", "0.8:60")
    assert (lit - plain)[..., 0].max() > 0.01
    assert (more - plain)[..., 0].max() == pytest.approx(
        59 / 7 * (lit - plain)[..., 0].max(), rel=0.1
    )
    assert np.abs((lit - plain)[:4]).max() < 1 / 255
    np.testing.assert_array_equal(shown(hdr, "a"), shown(hdr, "b", "--highlights", "auto"))
    np.testing.assert_array_equal(plain, shown(photo, "off", "--highlights", "off"))


def test_a_speck_in_focus_stays_where_soft_depth_blurs_it(tmp_path):
    x = np.arange(96)
    disparity = 0.02 + 0.48 * np.clip((44 - x) / 8 + 0.5, 0, 1)  # of 8 px around an edge at 44
    depth = depth_exr(tmp_path / "d.exr", np.tile((1 / disparity).astype(np.float32), (64, 1)))
    picture = np.full((64, 96, 3), 90, np.uint8)
    picture[:, 44:] = (20, 60, 30)
    picture[30:32, 41:43] = 255
    photo = save(tmp_path / "photo.png", picture)
    arguments = ("-o", tmp_path / "out", *LENS, "--sensor-width", "4mm", "--highlights", "auto")
    succeed("render", photo, depth, *arguments)
    assert read_exr(tmp_path / "out" / "render" / "photo.exr")["G"].max() < 1.1


def test_focus_shows_what_is_sharp_without_rendering(tmp_path):
    metres = np.tile(np.linspace(1, 4, 240, dtype=np.float32), (160, 1))
    color = color_exr(tmp_path / "a.exr", np.full((160, 240, 3), 0.5, np.float32))
    depth = depth_exr(tmp_path / "d.exr", metres)
    options = ("-o", tmp_path / "out", *LENS, "--outputs", "focus,coc", "--exr-type", "float")
    succeed("render", color, depth, *options)
    shown = read_exr(tmp_path / "out/focus/a.exr")
    coc = read_exr(tmp_path / "out/coc/a.exr")["coc"][0]
    red, green, blue = (shown[name][0] for name in "RGB")
    sharp, near, far = np.abs(coc) <= 1, coc < -1.5, coc > 1.5
    assert sharp.any()
    assert ((green > 2 * red) & (green > 2 * blue))[sharp].all()
    assert (red >= green)[near].all()
    assert (blue >= green)[far].all()
    assert shown["R"].shape == metres.shape
    assert records(tmp_path / "out")[-1]["seconds"]["render"] == 0
