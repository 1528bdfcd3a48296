"""A blur in pixels: the radius is linear in the numbers of the depth file, which need no metres."""

import numpy as np
import pytest
import torch
from command_line import color_exr, ramp, read_exr, refused, run, succeed, texture, write_exr
from image_files import save

from defocus_core import UsageProblem, radius_from_relative_disparity, run_batch, samples

BLUR = ("--blur", "8px", "--focus-value", "2")
NUMBERS = np.random.default_rng(2).uniform(-3, 9, (16, 24)).astype(np.float32)


def depth(path, numbers=NUMBERS):
    return write_exr(path, Z=np.asarray(numbers, np.float32))


def radius(folder, numbers, *options):
    color = color_exr(folder / "rgb.exr")
    z = depth(folder / "z.exr", numbers)
    succeed("render", color, z, *options, "--outputs", "coc", "-o", folder / "out", "--overwrite")
    return read_exr(folder / "out" / "coc" / "rgb.exr")["coc"]


def test_the_radius_is_linear_in_the_numbers(tmp_path):
    found = radius(tmp_path, NUMBERS, *BLUR)
    wanted = 8 * (2 - NUMBERS) / np.abs(2 - NUMBERS).max()
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)
    assert np.abs(found).max() == pytest.approx(8)
    law = radius_from_relative_disparity(torch.from_numpy(NUMBERS), 2.0, 8.0)
    np.testing.assert_allclose(found, law, atol=1e-5)


def test_scale_and_offset_of_the_numbers_change_nothing(tmp_path):
    options = ("--blur", "8px", "--focus-at", "5,3")
    own = radius(tmp_path, NUMBERS, *options)
    assert own[3, 5] == 0
    np.testing.assert_allclose(radius(tmp_path, 4 * NUMBERS + 20, *options), own, atol=1e-5)
    inverted = radius(tmp_path, -NUMBERS, *options, "--invert")
    np.testing.assert_allclose(inverted, own, atol=1e-5)


def test_a_grey_picture_is_all_that_it_takes(tmp_path):
    grey = np.round(np.tile(np.linspace(0, 255, 24), (16, 1)))[..., None].astype(np.uint8)
    rgb = save(tmp_path / "rgb.png", (texture() * 255).astype(np.uint8))
    z = save(tmp_path / "z.png", np.repeat(grey, 3, 2))
    blur = ("--blur", "6px", "--focus-value", "0")
    ran = run("render", rgb, z, *blur, "-o", tmp_path / "o", "--json")
    (told,) = ran.json["pictures"]
    assert (ran.code, told["coc_px"]) == (0, [-6.0, 0.0])
    assert not told["warnings"]
    own = run("info", z, *blur, "--json").json["files"][0]["depth"]
    assert (own["coc_px"], own["range"], own["range_m"]) == ([-6.0, 0.0], [0.0, 255.0], None)


@pytest.mark.parametrize("how", ["nearest", "guided"])
def test_depth_of_another_size_is_resized_whatever_its_scale(how, tmp_path):
    steps = np.where(np.arange(12) < 5, 1, 6) + np.zeros((8, 1))
    options = ("--blur", "8px", "--focus-value")
    own = radius(tmp_path, steps, *options, "6", "--resize-depth", how)
    np.testing.assert_allclose(own[:, :9], 8, atol=1e-4)
    np.testing.assert_allclose(own[:, 15:], 0, atol=1e-4)
    moved = radius(tmp_path, 20 - 3 * steps, *options, "2", "--invert", "--resize-depth", how)
    np.testing.assert_allclose(moved, own, atol=1e-4)


def test_one_scale_holds_for_all_that_a_lens_sees(tmp_path):
    alpha = np.zeros((16, 24), np.float32)
    alpha[4:12, 6:18] = 1
    planes = {name: alpha.copy() for name in "RGBA"}
    element = write_exr(tmp_path / "e.exr", **planes, Z=np.full((16, 24), 4, np.float32))
    opaque = {name: np.ones((16, 24), np.float32) for name in "RGBA"}
    plate = write_exr(tmp_path / "p.exr", **opaque, Z=NUMBERS)
    words = ("--blur", "6px", "--focus-value", "3", "--outputs", "coc", "-o", tmp_path / "out")
    succeed("render", element, *words, "--over", plate)
    numbers = np.where(alpha > 0, 4, NUMBERS)
    wanted = 6 * (3 - numbers) / np.abs(3 - NUMBERS).max()
    found = read_exr(tmp_path / "out" / "coc" / "e.exr")["coc"]
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)


def test_no_radius_is_larger_than_the_clamp(tmp_path):
    free = radius(tmp_path, NUMBERS, *BLUR)
    color, z = tmp_path / "rgb.exr", tmp_path / "z.exr"
    lens = ("--focal-length", "50mm", "--fnumber", "1.4", "--focus", "2m")
    for own, numbers in (((), NUMBERS), (lens, ramp())):
        options = own or BLUR
        whole = radius(tmp_path, numbers, *options)
        limit = float(np.abs(whole).max()) / 2
        clamped = radius(tmp_path, numbers, *options, "--clamp-blur", f"{limit}px")
        np.testing.assert_allclose(clamped, np.clip(whole, -limit, limit), rtol=1e-6)
    count = int((np.abs(free) > 4).sum())
    depth(z)
    options = (*BLUR, "--clamp-blur", "4px", "-o", tmp_path / "b")
    ran = run("render", color, z, *options)
    assert f"radius of {count} pixels clamped to 4 px" in ran.err


def test_what_blurs_nothing_or_all_is_refused(tmp_path):
    color, z = color_exr(tmp_path / "rgb.exr"), depth(tmp_path / "z.exr")
    flat, out = depth(tmp_path / "flat.exr", np.full((16, 24), 4)), ("-o", tmp_path / "out")
    ran = run("render", color, z, "--blur", "1e7px", "--focus-value", "2", *out)
    refused(ran, 2, "malformed", "blur")
    ran = run("render", color, flat, "--blur", "8px", "--focus-at", "1,1", "--invert", *out)
    refused(ran, 3, "no-valid-depth", flat)
    for name in ("blur", "clamp-blur", "focus-value"):  # an opening has none
        refused(run("aperture", f"--{name}", "4", "-o", tmp_path / "a.png"), 2, None)


def test_a_lens_beside_a_blur_in_pixels_is_refused_wherever_it_comes_from(tmp_path):
    color, z = color_exr(tmp_path / "rgb.exr"), depth(tmp_path / "z.exr")
    ran = run("render", color, z, *BLUR, "--lens", "@hexagon-50", "-o", tmp_path / "out")
    refused(ran, 2, "contradiction", "lens")
    assert "for its aperture give --blades 6 --blade-rotation 15" in ran.err
    refused(run("info", z, *BLUR, "--lens", "@hexagon-50"), 2, "contradiction", "lens")
    ran = run("render", color, z, *BLUR, "--lens-from-metadata", "-o", tmp_path / "out")
    refused(ran, 2, "contradiction", "lens-from-metadata")
    own = tmp_path / "own.toml"
    own.write_text('blur = "8px"\nfocus-value = 2\nfnumber = 2\n')
    ran = run("render", color, z, "--lens", own, "-o", tmp_path / "out")
    refused(ran, 2, "contradiction", own, "fnumber")
    own.write_text('blur = "3px"\nfocus-value = 2\nblades = 5\n')
    ran = run("render", color, z, "--lens", own, "--blur", "8px", "-o", tmp_path / "out", "-v")
    assert "blur of 8px, focus on the number 2, 5 blades" in ran.err
    inputs = {"color": str(color), "depth": str(z)}
    for tables, field in (
        ({"lens": {"file": "@hexagon-50", "blur": "8px", "focus-value": 2}}, "file"),
        ({"lens": {"file": "@hexagon-50", "focus-value": 2}, "sweep": {"blur": ["8px"]}}, "file"),
        (
            {"lens": {"lens-from-metadata": True, "blur": "8px", "focus-value": 2}},
            "lens-from-metadata",
        ),
    ):
        with pytest.raises(UsageProblem) as error:
            run_batch({"inputs": inputs, **tables}, tmp_path / "out")
        assert (error.value.code, error.value.field) == ("contradiction", field)


def test_a_range_of_the_numbers_of_the_file_stays_sharp(tmp_path):
    low, high = np.percentile(NUMBERS, (30, 60))
    text = f"{low:g}..{high:g}"
    found = radius(tmp_path, NUMBERS, "--blur", "8px", "--sharp-range", text)
    within = (low <= NUMBERS) & (high >= NUMBERS)
    assert (found[within] == 0).all()
    assert (np.sign(found[~within]) == np.sign(low - NUMBERS[~within])).all()
    assert np.abs(found).max() == pytest.approx(8, rel=1e-3)
    beyond = np.maximum(float(f"{low:g}") - NUMBERS, NUMBERS - float(f"{high:g}"))[~within]
    np.testing.assert_allclose(np.abs(found[~within]), 8 * beyond / beyond.max(), rtol=1e-4)
    args = ("--invert", "--blur", "8px", "--sharp-range", text)
    inverted = radius(tmp_path / "inverted", NUMBERS, *args)
    np.testing.assert_allclose(inverted, -found, rtol=1e-4)
    assert not np.signbit(inverted[within]).any()


def test_such_a_range_is_told_in_the_numbers_of_the_file_everywhere(tmp_path):
    out, near = tmp_path / "out", "-2.14..10"
    files = color_exr(tmp_path / "rgb.exr"), depth(tmp_path / "z.exr")
    inputs = dict(zip(("color", "depth"), map(str, files), strict=True))
    sweep = {"sharp-range": ["0..3", near]}
    run_batch({"inputs": inputs, "lens": {"blur": "8px"}, "sweep": sweep}, out)
    names = {"rgb_sharp0-3": (0.0, 3.0), "rgb_sharp-2.14-10": (-2.14, 10.0)}
    assert {sample.sample_id: sample.lens.sharp_range for sample in samples(out)} == names
    assert {path.stem for path in (out / "render").iterdir()} == names.keys()
    journal = (out / "journal.jsonl").read_text()
    assert f'"sharp_range":"{near}"' in journal
    more = ("--blur", "8px", "--sharp-range", near, "-o", tmp_path / "one")
    assert f" sharp range {near}," in succeed("render", *inputs.values(), *more).err
