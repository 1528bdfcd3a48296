"""--over: an element and its plate are blurred as one scene."""

import math

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from command_line import header, read_exr, refused, run, succeed
from deep_files import write_deep_samples
from elements import SIZE, disc, element, write
from image_files import save

# Radii of 3 to 4 px at the depths below.
LENS = ("--focal-length", "120mm", "--fnumber", "1.2", "--focus")
FLOATS = ("--exr-type", "float")


def smooth(seed):
    """R, G and B that change slowly."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    waves = (np.sin(x / rng.uniform(3, 8) + y / rng.uniform(3, 8)) for _ in range(3))
    return {
        name: (0.5 + 0.4 * wave).astype(np.float32) for name, wave in zip("RGB", waves, strict=True)
    }


def scene(folder, near, far):
    """Files of an element, of its plate and of their union, and the alpha of the element."""
    alpha, colors, plate = disc(), smooth(1), smooth(2)
    own = element(alpha, depth=near) | {name: alpha * plane for name, plane in colors.items()}
    plate["Z"] = np.full(SIZE, far, np.float32)
    union = {name: own[name] + (1 - alpha) * plate[name] for name in "RGB"}
    union["Z"] = np.where(alpha >= 0.5, np.float32(near), np.float32(far))
    files = (("ball", own), ("plate", plate), ("union", union))
    ball, below, whole = (write(folder / name / "a.exr", planes) for name, planes in files)
    return ball, below, whole, alpha


def picture(out, *args, focus="1m"):
    succeed("render", *args, "-o", out, *LENS, focus, *FLOATS)
    return read_exr(out / "render" / "a.exr")


def equal(one, other):
    return all(np.array_equal(one[name], other[name]) for name in "RGBA")


def psnr(seen, expected, where):
    error = np.mean([np.square(seen[n] - expected[n], dtype=float)[where].mean() for n in "RGB"])
    return math.inf if error == 0 else float(-10 * np.log10(error))


@pytest.mark.parametrize(("near", "far", "focus"), [(0.8, 1.5, "1.5m"), (0.8, 1.4, "1m")])
def test_it_is_the_scene_rendered_whole_where_nothing_is_hidden(near, far, focus, tmp_path):
    ball, below, whole, _ = scene(tmp_path, near, far)
    over = picture(tmp_path / "o", ball, "--over", below, focus=focus)
    expected = picture(tmp_path / "w", whole, focus=focus)
    apart = np.abs(np.hypot(*(np.mgrid[: SIZE[0], : SIZE[1]] - [[[19.5]], [[29.5]]])) - 11) > 9
    assert 0.1 < apart.mean() < 0.9
    assert psnr(over, expected, apart) > 50
    assert psnr(over, expected, slice(None)) > 30, "and near the edges it is alike"
    np.testing.assert_allclose(over["A"], 1, atol=1e-5)


def test_a_plate_nearer_than_the_element_hides_it(tmp_path):
    ball, below, _, _ = scene(tmp_path, 3.0, 1.0)
    seen, plate = picture(tmp_path / "o", ball, "--over", below), read_exr(below)
    for name in "RGB":
        np.testing.assert_allclose(seen[name], plate[name], atol=1e-4)


def test_a_plate_is_an_exr_two_files_or_a_folder_and_stands_in_jobs_files(tmp_path):
    ball, below, _, _ = scene(tmp_path, 0.8, 1.6)
    expected, planes = picture(tmp_path / "o", ball, "--over", below), read_exr(below)
    depth = write(tmp_path / "z.exr", {"Z": planes.pop("Z")})
    colors = write(tmp_path / "rgb.exr", planes)
    apart = ("--over", colors, "--over-depth", depth)
    after = picture(tmp_path / "p", ball, *apart)
    assert header(tmp_path / "p" / "render" / "a.exr")["defocus:over"] == "rgb.exr z.exr"
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(
        '[inputs]\ncolor = "ball/*.exr"\nover-color = "plate/*.exr"\n'
        '[lens]\nfocal-length = "120mm"\n'
        'fnumber = 1.2\nfocus = "1m"\n[outputs]\nexr-type = "float"\n'
    )
    succeed("batch", jobs, "-o", tmp_path / "q")
    for seen in (
        after,
        picture(tmp_path / "t", "--memory", "2GB", "-q", ball, *apart),
        picture(tmp_path / "s", ball.parent, "--over", below.parent),
        read_exr(tmp_path / "q" / "render" / "a.exr"),
    ):
        assert equal(seen, expected)


def test_a_plate_without_depth_is_infinitely_far_and_said_to_be(tmp_path):
    ball, below, _, _ = scene(tmp_path, 0.8, np.inf)
    planes = read_exr(below)
    del planes["Z"]
    colors = write(tmp_path / "rgb.exr", planes)
    expected = picture(tmp_path / "o", ball, "--over", below)
    ran = run("render", ball, "-o", tmp_path / "p", *LENS, "1m", *FLOATS, "--over", colors)
    assert "rgb.exr: the plate has no depth and is taken as infinitely far" in ran.err
    assert equal(read_exr(tmp_path / "p" / "render" / "a.exr"), expected)
    png = save(tmp_path / "plate.png", np.full((*SIZE, 3), 128, np.uint8))
    assert picture(tmp_path / "q", ball, "--over", png)["A"].min() > 1 - 1e-5


IN_FOCUS = ("--focal-length", "1mm", "--fnumber", "64", "--focus", "5m", *FLOATS)


def samples(rng):
    """One to three samples, and a wall behind them."""
    made = [{"R": 0.2, "G": 0.3, "B": 0.4, "A": 1.0, "Z": 12.0}]
    for _ in range(rng.integers(1, 4)):
        near, alpha = rng.uniform(2, 9), rng.uniform(0.1, 0.9)
        light = dict(zip("RGB", alpha * rng.random(3), strict=True))
        made.append({**light, "A": alpha, "Z": near})
    return made


def flattened(first, second):
    """The pictures merged sample by sample, in focus: R, G, B and A [H, W, 4]."""
    merged = oiio.ImageBufAlgo.flatten(oiio.ImageBufAlgo.deep_merge(first, second))
    return merged.get_pixels("float")[..., :4]


def test_of_deep_pictures_it_is_the_merge_of_their_samples(tmp_path):
    rng = np.random.default_rng(1)
    pixels = [[[samples(rng) for _ in range(8)] for _ in range(6)] for _ in range(2)]
    for row in pixels[0]:
        for each in row:
            del each[0]  # the element has no wall
    pixels[0][0][0].append({**pixels[1][0][0][1], "A": 0.5})  # two in one place
    element, plate = (
        write_deep_samples(tmp_path / f"{name}.exr", each, light="float")
        for name, each in zip(("a", "plate"), pixels, strict=True)
    )
    succeed("render", element, "-o", tmp_path / "o", *IN_FOCUS, "--over", plate)
    seen = read_exr(tmp_path / "o" / "render" / "a.exr")
    merged = flattened(oiio.ImageBuf(str(element)), oiio.ImageBuf(str(plate)))
    for k, name in enumerate("RGBA"):
        np.testing.assert_allclose(seen[name], merged[..., k], atol=1e-5)


def test_over_a_deep_plate_an_element_lies_between_its_samples(tmp_path):
    alpha = disc()
    ball = write(tmp_path / "a.exr", element(alpha, (1, 0, 0), depth=5.0))
    fog = {"R": 0.1, "G": 0.1, "B": 0.1, "A": 0.2, "Z": 2.0}
    wall = {"R": 0.0, "G": 0.5, "B": 0.0, "A": 1.0, "Z": 10.0}
    pixels = [[[fog, wall]] * SIZE[1]] * SIZE[0]
    plate = write_deep_samples(tmp_path / "plate.exr", pixels, light="float")
    succeed("render", ball, "-o", tmp_path / "o", *IN_FOCUS, "--over", plate)
    seen = read_exr(tmp_path / "o" / "render" / "a.exr")
    for name in "RGB":
        behind = alpha * (name == "R") + (1 - alpha) * wall[name]
        np.testing.assert_allclose(seen[name], fog[name] + 0.8 * behind, atol=1e-5)
    blurred = picture(tmp_path / "b", ball, "--over", plate, focus="10m")
    assert blurred["R"][20, 30] > 0.7, "the middle of the ball is no plate"


def test_what_makes_no_scene_is_refused(tmp_path):
    ball, below, _, _ = scene(tmp_path, 0.8, 1.6)
    planes, ap1 = read_exr(below), (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    small = write(tmp_path / "s.exr", {name: plane[:-2] for name, plane in planes.items()})
    grey = write(tmp_path / "y.exr", {"Y": planes["R"], "Z": planes["Z"]})
    acescg = write(tmp_path / "acescg.exr", planes, chromaticities=ap1)
    for words, exit_code, code, at in (
        ((ball, "--over", small), 3, "wrong-size", small),
        ((ball, "--over", grey), 3, "wrong-size", grey),
        ((below, "--over", below), 3, "idle-option", below),
        ((ball, "--over", below, "--hidden", below, below), 2, "contradiction", "hidden"),
        ((ball, "--over-depth", below), 2, "missing-option", "over-depth"),
        ((ball, "--over", acescg), 3, "wrong-type", acescg),
    ):
        ran = run("render", *words, "-o", tmp_path / "o", *LENS, "1m")
        refused(ran, exit_code, code, at)


@pytest.mark.parametrize("far", [1.0, 1.1])
def test_behind_nearer_parts_of_an_element_is_the_rest_of_it_and_not_the_plate(far, tmp_path):
    """An element with alpha 1 all over hides its plate, as if rendered alone."""
    _, below, _, _ = scene(tmp_path, 0.8, 2.0)
    is_near = np.arange(SIZE[1]) < SIZE[1] // 2
    colors = {"R": 0.8, "G": 0.2, "B": 0.5}
    planes = {n: np.where(is_near, c, 1 - c) * np.ones(SIZE) for n, c in colors.items()}
    planes["Z"] = np.where(is_near, 0.8, far) * np.ones(SIZE)
    alone = write(tmp_path / "own" / "a.exr", {n: p.astype("f4") for n, p in planes.items()})
    planes["A"] = np.ones(SIZE)
    whole = write(tmp_path / "all" / "a.exr", {n: p.astype("f4") for n, p in planes.items()})
    planes["A"][:3, -3:] = 0
    part = write(tmp_path / "part" / "a.exr", {n: p.astype("f4") for n, p in planes.items()})
    expected = picture(tmp_path / "o", alone)
    for name, element_file in (("all", whole), ("part", part)):
        seen = picture(tmp_path / name, element_file, "--over", below)
        for channel in "RGB":
            off = np.abs(seen[channel] - expected[channel])[12:, : -SIZE[1] // 4]
            assert off.max() < 0.02, (name, channel)
