"""Elements: nothing where alpha is 0, windows of all kinds, depth multiplied by alpha, views."""

from typing import Any

import numpy as np
import OpenEXR
import pytest
from command_line import header, read_exr, refused, run, succeed
from elements import METRES, SIZE, disc, element, write, write_within
from image_files import SCANLINE, box

from defocus_core import read_color

LENS = ("--focal-length", "120mm", "--fnumber", "1.2", "--focus")
FLOATS = ("--exr-type", "float")


def render(file, out, *args, focus="1m"):
    return run("render", file, "-o", out, *LENS, focus, *FLOATS, *args)


def picture(file, out, *args, focus="1m"):
    """The channels of the rendered picture."""
    ran = render(file, out, *args, focus=focus)
    assert ran.code == 0, ran.err
    return read_exr(out / "render" / f"{file.stem}.exr")


def rgba(planes):
    return np.stack([planes[name] for name in "RGBA"])


def shown(file):
    """R, G, B and A over the display window."""
    return read_color(file).pixels.transpose(2, 0, 1)


@pytest.mark.parametrize("said", [np.nan, -np.inf, 0.4], ids=str)
def test_where_alpha_is_0_there_is_nothing_whatever_depth_says(said, tmp_path):
    planes = element(disc())
    expected = picture(write(tmp_path / "a.exr", planes), tmp_path / "zero")
    planes["Z"] = np.where(planes["A"] > 0, planes["Z"], np.float32(said))
    made = write(tmp_path / "b" / "a.exr", planes)
    found = picture(made, tmp_path / "o", "--outputs", "render,coc,disparity")
    np.testing.assert_array_equal(rgba(found), rgba(expected))
    for kind in ("coc", "disparity"):
        values = read_exr(tmp_path / "o" / kind / "a.exr")[kind]
        assert (values[planes["A"] == 0] == 0).all()
        assert (values[planes["A"] > 0] > 1).all()


def test_alpha_is_added_where_a_picture_without_it_has_pixels(tmp_path):
    planes = {name: np.full(SIZE, 0.5, np.float32) for name in "RGB"}
    planes["Z"] = np.full(SIZE, METRES, np.float32)
    picture(write_within(tmp_path / "a.exr", planes, (20, 9, 39, 28)), tmp_path / "o")
    card = np.zeros(SIZE, np.float32)
    card[9:29, 20:40] = 1
    made = write(tmp_path / "b.exr", element(card, (0.5, 0.5, 0.5)))
    grown = shown(tmp_path / "o" / "render" / "a.exr")
    np.testing.assert_allclose(grown, rgba(picture(made, tmp_path / "p")), atol=1e-6)


def test_overscan_takes_part_in_the_blur_and_is_cropped_after_it(tmp_path):
    rng = np.random.default_rng(0)
    planes = {name: rng.random(SIZE, np.float32) for name in "RGB"}
    planes["Z"] = np.full(SIZE, METRES, np.float32)
    left, top, right, bottom = 8, 5, 12, 7
    shown = box(0, 0, SIZE[1] - 1 - left - right, SIZE[0] - 1 - top - bottom)
    data = box(-left, -top, shown[1][0] + right, shown[1][1] + bottom)
    made = write(tmp_path / "a.exr", planes, dataWindow=data, displayWindow=shown)
    seen = picture(made, tmp_path / "o", "--sensor-width", "20mm")
    # The whole of it, of pixels of the same size: 20 mm for 40 px.
    whole = picture(write(tmp_path / "b.exr", planes), tmp_path / "p", "--sensor-width", "30mm")
    inner = np.s_[top:-bottom, left:-right]
    for name in "RGB":
        np.testing.assert_allclose(seen[name], whole[name][inner], atol=2e-6)
    cropped = header(tmp_path / "o" / "render" / "a.exr")["dataWindow"]
    assert np.ravel(cropped).tolist() == [0, 0, *shown[1]]
    kept = picture(made, tmp_path / "k", "--sensor-width", "20mm", "--keep-overscan")
    for name in "RGB":
        np.testing.assert_allclose(kept[name], whole[name], atol=2e-6)
    told = header(tmp_path / "k" / "render" / "a.exr")
    assert np.ravel(told["dataWindow"]).tolist() == np.ravel(data).tolist()
    assert np.ravel(told["displayWindow"]).tolist() == np.ravel(shown).tolist()
    words = ("--outputs", "image,depth", "--keep-overscan")
    succeed("render", made, "-o", tmp_path / "k", *LENS, "1m", *words)
    for kind, name in (("image", "R"), ("depth", "Z")):
        given = read_exr(tmp_path / "k" / kind / "a.exr")
        np.testing.assert_array_equal(given[name], planes[name].astype(given[name].dtype))


def test_overscan_that_the_depth_lacks_is_left_out_of_the_blur(tmp_path):
    planes = {name: np.full(SIZE, 0.5, np.float32) for name in "RGB"}
    data, shown = box(-4, 0, SIZE[1] - 5, SIZE[0] - 1), box(0, 0, SIZE[1] - 5, SIZE[0] - 1)
    made = write(tmp_path / "a.exr", planes, dataWindow=data, displayWindow=shown)
    metres = write(tmp_path / "z.exr", {"Z": np.full((SIZE[0], SIZE[1] - 4), METRES, np.float32)})
    ran = succeed("render", made, metres, "-o", tmp_path / "o", *LENS, "1m", "-v")
    assert "cropped from 60x40 at -4,0 to the display window" in ran.err


def test_depth_multiplied_by_alpha_is_divided_again_and_none_of_its_own(tmp_path):
    planes = element(disc())
    made = write(tmp_path / "a.exr", planes)
    ran = render(made, tmp_path / "o", "-v")
    assert "divided by alpha" not in ran.err
    expected = rgba(read_exr(tmp_path / "o" / "render" / "a.exr"))
    planes["Z"] = planes["Z"] * planes["A"]
    ran = render(write(tmp_path / "b" / "a.exr", planes), tmp_path / "p", "-v")
    assert "divided by alpha" in ran.err
    pixels = rgba(read_exr(tmp_path / "p" / "render" / "a.exr"))
    np.testing.assert_allclose(pixels, expected, atol=1e-4)


def test_edges_whose_depth_missed_the_object_have_that_beside_them(tmp_path):
    planes = element(disc())
    expected = picture(write(tmp_path / "a.exr", planes), tmp_path / "o")
    planes["Z"] = np.where(planes["A"] < 0.5, np.float32(0), planes["Z"])
    ran = render(write(tmp_path / "b" / "a.exr", planes), tmp_path / "p", "-v")
    assert "edge pixels given the depth beside them" in ran.err
    pixels = rgba(read_exr(tmp_path / "p" / "render" / "a.exr"))
    np.testing.assert_array_equal(pixels, rgba(expected))


def shape_of(kind):
    """Alpha [80, 80] of a disc of 60 px, or of hair on a head of 16 px."""
    y, x = np.mgrid[:640, :640] / 8 + 1 / 16 - 40
    radius = np.hypot(x, y)
    hair = np.abs(np.sin(6 * np.arctan2(y, x) + 1)) * radius / 6 < 0.3  # 0.6 px wide: not whole
    inside = radius < 30 if kind == "disc" else (hair & (radius < 36)) | (radius < 8)
    return inside.reshape(80, 8, 80, 8).mean((1, 3)).astype(np.float32)


def grey(alpha, metres):
    planes = {name: alpha * np.float32(0.5) for name in "RGB"}
    return planes | {"A": alpha, "Z": metres.astype(np.float32)}


@pytest.mark.parametrize(("far", "nothing"), [(30.0, None), (1e10, 0.0), (None, None)])
@pytest.mark.parametrize(("kind", "power"), [("disc", 1), ("disc", -1), ("hair", 1), ("hair", -1)])
def test_edges_of_averaged_depth_are_those_of_the_object(kind, power, far, nothing, tmp_path):
    """In focus, so that the output is the input; far None is a background of 12 m."""
    alpha = shape_of(kind)
    averaged = np.where(alpha < 0.5, 12.0, 4.0)
    if far is not None:
        averaged = (alpha * 4.0**power + (1 - alpha) * far**power) ** (1 / power)
    z = averaged if nothing is None else np.where(alpha > 0, averaged, nothing)
    planes = grey(alpha, z)
    made = write(tmp_path / "a.exr", planes)
    for how in ("auto", "off"):
        seen = picture(made, tmp_path / how, "--depth-repair", how, focus="4m")
        assert np.abs(rgba(seen) - rgba(planes)).max() < 0.02


def test_averages_of_which_no_depth_is_left_are_told(tmp_path):
    alpha = shape_of("hair") * np.float32(0.9)  # nothing is whole
    made = write(tmp_path / "a.exr", grey(alpha, alpha * 4 + (1 - alpha) * 1e10))
    ran = render(made, tmp_path / "o", focus="4m")
    assert "edge pixels hold averages of depth with what is far away" in ran.err


def test_depth_that_does_not_go_with_alpha_stays_as_it_is(tmp_path):
    alpha = shape_of("hair")
    planes = grey(alpha, np.tile(np.linspace(3.8, 4.4, 80), (80, 1)))
    made = write(tmp_path / "a.exr", planes)
    ran = render(made, tmp_path / "o", "--outputs", "depth", "-v")
    assert "edge pixel" not in ran.err


def test_light_without_alpha_stays_where_it_has_a_depth(tmp_path):
    planes = element(disc())
    planes["R"][4, 6] = 3.0
    planes["Z"][4, 6] = METRES
    ran = render(write(tmp_path / "a.exr", planes), tmp_path / "o", "-v")
    assert "light without alpha in 1 pixel" in ran.err
    red = read_exr(tmp_path / "o" / "render" / "a.exr")["R"]
    assert red.sum() == pytest.approx(planes["R"].sum(), rel=1e-3)


def test_nothing_cannot_be_focused_on(tmp_path):
    made = write(tmp_path / "a.exr", element(disc()))
    ran = run("render", made, "-o", tmp_path / "o", *LENS[:4], "--focus-at", "0,0")
    refused(ran, 2, "no-valid-depth", "focus-at")
    empty = write(tmp_path / "b.exr", element(np.zeros(SIZE, np.float32)))
    refused(render(empty, tmp_path / "p", focus="percentile(50)"), 3, "no-valid-depth", empty)
    assert rgba(picture(empty, tmp_path / "q")).max() == 0


VIEWS = {"right": element(disc()), "left": element(disc(center=(19.5, 33.5)), depth=2.0)}


def views_in_one_part(path):
    planes = VIEWS["right"] | {f"left.{name}": plane for name, plane in VIEWS["left"].items()}
    planes |= {"motion.left.u": disc(5), "motion.right.u": disc(6)}
    return write(path, planes, multiView=["right", "left"])


def views_in_parts(path):
    parts = []
    for view, planes in VIEWS.items():
        for name, channels in (("rgba", "RGBA"), ("depth", "Z")):
            named = {"name": f"{name}.{view}", "view": view, **SCANLINE}
            parts.append(OpenEXR.Part(named, {c: planes[c] for c in channels}))
    OpenEXR.File(parts).write(str(path))
    return path


@pytest.mark.parametrize("make", [views_in_one_part, views_in_parts])
def test_a_view_is_rendered_as_if_it_were_alone(make, tmp_path):
    made = make(tmp_path / "a.exr")
    alone = picture(write(tmp_path / "b" / "a.exr", VIEWS["left"]), tmp_path / "alone")
    seen = picture(made, tmp_path / "left", "--view", "left")
    np.testing.assert_array_equal(rgba(seen), rgba(alone))
    told = header(tmp_path / "left" / "render" / "a.exr")
    assert told["view"] == "left"
    assert {name for name in seen if name not in "RGBAZ"} <= {"motion.u", "depth.Z"}
    default = render(made, tmp_path / "default")
    assert "view right taken, the default of right, left; --view names another" in default.err
    right = picture(made, tmp_path / "right", "--view", "right")
    taken = read_exr(tmp_path / "default" / "render" / "a.exr")
    np.testing.assert_array_equal(rgba(taken), rgba(right))


def passes(path):
    """A near card before a far wall, as the sum of two passes, with data beside them."""
    rng = np.random.default_rng(3)
    card = np.zeros(SIZE, bool)
    card[10:28, 18:40] = True
    planes: dict[str, Any] = {"Z": np.where(card, np.float32(0.8), np.float32(3))}
    for name in "RGB":
        planes[f"diffuse.{name}"] = rng.random(SIZE, np.float32)
        planes[f"specular.{name}"] = rng.random(SIZE, np.float32) * card
        planes[name] = planes[f"diffuse.{name}"] + planes[f"specular.{name}"]
    planes["diffuse.id"] = card.astype(np.uint32)
    planes["N.X"] = rng.random(SIZE, np.float32)
    return write(path, planes), planes


def test_passes_are_blurred_with_the_picture_and_data_is_copied(tmp_path):
    made, planes = passes(tmp_path / "a.exr")
    seen = picture(made, tmp_path / "o", "--blur-channels", "diffuse.*,Specular.*")
    assert seen.keys() == planes.keys()
    for name in "RGB":
        total = seen[f"diffuse.{name}"] + seen[f"specular.{name}"]
        # pixels on an edge are taken apart by the colours of each
        assert np.abs(total - seen[name]).max() < 0.03
        assert np.abs(total - seen[name]).mean() < 3e-3
        assert np.abs(seen[f"diffuse.{name}"] - planes[f"diffuse.{name}"]).mean() > 0.02
    for name in ("Z", "N.X", "diffuse.id"):
        np.testing.assert_array_equal(seen[name], planes[name])
    succeed("render", made, "-o", tmp_path / "h", *LENS, "1m", "--blur-channels", "diffuse.*")
    halves = read_exr(tmp_path / "h" / "render" / "a.exr")
    assert halves["diffuse.R"].dtype == np.float16
    assert halves["specular.R"].tobytes() == planes["specular.R"].tobytes()


@pytest.mark.parametrize("alpha", [False, True])
def test_passes_add_up_to_their_picture_if_colours_focus_apart(alpha, tmp_path):
    """Before a plane of one depth rendering is linear."""
    planes: dict[str, Any] = {"Z": np.full(SIZE, 3, np.float32)}
    rng, look = np.random.default_rng(3), ("--axial-color", "0.3mm:-0.2mm")
    for name in "RGB":
        planes[name] = rng.random(SIZE, np.float32) / 4
        planes[f"lamp.{name}"] = planes[name] * rng.random(SIZE, np.float32)
        planes[f"Rest.{name}"] = planes[name] - planes[f"lamp.{name}"]
    if alpha:
        planes["A"] = np.ones(SIZE, np.float32)
        planes["A"][:, :6] = 0
        for name in planes.keys() - {"A", "Z"}:
            planes[name] = planes[name] * planes["A"]
    made = write(tmp_path / "a.exr", planes)
    both = ("--blur-channels", "lamp.*,rest.*")
    plain = picture(made, tmp_path / "plain", *both)
    seen = picture(made, tmp_path / "seen", *both, *look)
    for name in "RGB":
        total = seen[f"lamp.{name}"] + seen[f"Rest.{name}"]
        np.testing.assert_allclose(total, seen[name], atol=2e-3 * seen[name].max())
    assert np.abs(seen["lamp.R"] - plain["lamp.R"]).max() > 1e-3


def test_what_is_no_light_is_not_blurred_and_passes_need_a_file_that_holds_them(tmp_path):
    made, _ = passes(tmp_path / "a.exr")
    for pattern in ("Z", "diffuse.id", "glossy.*"):
        ran = render(made, tmp_path / "o", "--blur-channels", pattern)
        refused(ran, 3, "no-such-channel", made)
    blurred = ("render", made, "-o", tmp_path / "o", *LENS, "1m", "--blur-channels", "N.X")
    refused(run(*blurred, "--format", "png"), 2, "idle-option", "blur-channels")
    refused(run(*blurred, "--highlights", "auto"), 2, "contradiction", "highlights")


def moments(plane):
    """Variances of light along x and y, in px²."""
    shares, places = plane / plane.sum(dtype=np.float64), np.indices(plane.shape)[::-1]
    return [float((shares * (at - (shares * at).sum()) ** 2).sum()) for at in places]


@pytest.mark.parametrize(("aspect", "squeeze"), [(0.5, 1.6), (2.0, 1.0)])
def test_pixels_that_are_not_square_show_ellipses(aspect, squeeze, tmp_path):
    planes = {name: np.zeros((80, 80), np.float32) for name in "RGB"}
    planes["R"][40, 40] = 100
    planes["Z"] = np.full((80, 80), METRES, np.float32)
    made = write(tmp_path / "a.exr", planes, pixelAspectRatio=aspect)
    lens = ("--sensor-width", "20mm", "--squeeze", str(squeeze))
    ran = render(made, tmp_path / "o", "--outputs", "render,coc", "-v", *lens)
    assert ran.code == 0, ran.err
    assert f"pixels {aspect:g} times as wide as high" in ran.err
    assert header(tmp_path / "o" / "render" / "a.exr")["pixelAspectRatio"] == aspect
    radius = float(read_exr(tmp_path / "o" / "coc" / "a.exr")["coc"][0, 0])
    across, down = moments(read_exr(tmp_path / "o" / "render" / "a.exr")["R"])
    # A uniform ellipse of half axes a and b; a pixel adds 1/12 px².
    assert across == pytest.approx((radius / squeeze) ** 2 / 4 + 1 / 12, rel=0.02)
    assert down == pytest.approx((radius * aspect) ** 2 / 4 + 1 / 12, rel=0.02)


def test_distances_to_the_point_need_square_pixels(tmp_path):
    planes = element(np.ones(SIZE, np.float32))
    made = write(tmp_path / "a.exr", planes, pixelAspectRatio=2.0)
    refused(render(made, tmp_path / "o", "--radial"), 3, "not-square", made)


def test_the_output_has_the_window_of_the_input_grown_by_the_blur(tmp_path):
    whole = {name: np.pad(plane, 40) for name, plane in element(disc()).items()}
    file = write_within(tmp_path / "a.exr", whole, (56, 46, 83, 73))
    lens = ("--focal-length", "50mm", "--fnumber", "1.4", "--focus", "2m", "--squeeze", "2")
    full = write(tmp_path / "b" / "a.exr", whole)
    for path, out in ((file, "o"), (full, "p")):
        succeed("render", path, "-o", tmp_path / out, *lens, *FLOATS, "--outputs", "render,left")
    for kind in ("render", "left"):
        found = tmp_path / "o" / kind / "a.exr"
        (x0, y0), (x1, y1) = header(found)["dataWindow"]
        assert shown(found).shape == (4, 120, 140)
        assert 56 - 12 <= x0 < 56
        assert 83 < x1 <= 83 + 12
        assert (56 - x0, 46 - y0) == (x1 - 83, y1 - 73)
        np.testing.assert_allclose(shown(found), shown(tmp_path / "p" / kind / "a.exr"), atol=1e-5)
