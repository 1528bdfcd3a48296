"""Deep EXR: the samples of each pixel are layers; what they say is rendered, and no more."""

import numpy as np
import torch
from command_line import LENS, read_exr, refused_input, run, succeed, write_exr
from deep_files import from_layers, write_deep_samples
from layers import brute_force
from measures import psnr

from defocus_core import DefocusLens

SIZE = (40, 56)
FLOAT = ("--exr-type", "float")


def layers(*metres, seed=0):
    """A layer with a soft round card for each depth: premultiplied colours, depth, coverage."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    places = 12 + rng.random((len(metres), 2)) * (16, 32)
    away = [np.hypot(y - row, x - column) for row, column in places]
    coverage = (np.clip(9 - np.stack(away), 0, 1) * 0.75).astype(np.float32)
    tint = rng.random((len(metres), 3, 1, 1)).astype(np.float32)
    depth = np.broadcast_to(np.float32(metres)[:, None, None], coverage.shape)
    return tint * coverage[:, None], depth, coverage


def radius_of(depth):
    """Signed radii in px of depths in metres, by the core's own lens."""
    sensor = 36.0, 36.0 * SIZE[0] / SIZE[1]
    lens = DefocusLens(50.0, 2.0, sensor, SIZE[::-1], "cpu", torch.float64)
    lens.refocus(2000.0)
    return lens.signed_radius(torch.from_numpy(depth * 1000.0).double())


def picture(path):
    """R, G, B, A of an EXR file."""
    rgba = read_exr(path)
    return torch.from_numpy(np.stack([rgba[name] for name in "RGBA"]).astype(np.float64))


def rendered(folder, name, samples, *args, **how):
    """The picture of deep samples that are written to a file of this name."""
    file = write_deep_samples(folder / f"{name}.exr", samples, **how)
    succeed("render", file, "-o", folder / name, *LENS, *FLOAT, *args)
    return picture(folder / name / "render" / f"{name}.exr")


def truth(color, depth, coverage):
    """What a lens would take, within the border."""
    colors, covers = torch.from_numpy(color), torch.from_numpy(coverage)
    return brute_force(colors, radius_of(depth), covers, 512)[..., 6:-6, 6:-6]


def test_a_deep_picture_is_near_the_brute_force_one(tmp_path):
    made = layers(0.8, 2.0, 6.0)
    wanted, samples = truth(*made), from_layers(*made)
    for name, light, tile in (("a", "half", 0), ("b", "float", 16)):
        shown = rendered(tmp_path, name, samples, light=light, tile=tile)
        assert psnr(shown[:, 6:-6, 6:-6], wanted) > 40


def test_samples_may_come_in_any_order_and_outside_windows_is_nothing(tmp_path):
    forward = from_layers(*layers(0.9, 4.0))
    backward = [[pixel[::-1] for pixel in row] for row in forward]
    window = {"corner": (3, 5), "full": (SIZE[1] + 8, SIZE[0] + 9)}
    one, other = (rendered(tmp_path, n, s, **window) for n, s in (("a", forward), ("b", backward)))
    assert one.shape == (4, SIZE[0] + 9, SIZE[1] + 8)
    assert torch.equal(one, other)


def test_coc_and_focus_are_those_of_the_first_surface(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    coverage[:] = 0
    coverage[1, 10:30, 10:40] = coverage[0, 10:30, 10:30] = 0.5
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    focus = ("--focus", "percentile(50)", "--outputs", "coc")
    ran = succeed("render", file, "-o", tmp_path / "out", *LENS[:4], *focus)
    assert "focus 1m" in ran.err
    coc = read_exr(tmp_path / "out/coc/a.exr")["coc"]
    assert not coc[10:30, 10:30].any()
    assert (coc[10:30, 30:40] > 0.8).all()
    assert not coc[:8].any()


def test_a_sample_without_alpha_and_light_decides_nothing(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    coverage[:] = 1
    rows = from_layers(color[1:], depth[1:], coverage[1:])
    nothing = {**dict.fromkeys("RGBA", 0.0), "Z": 0.5}
    glow = {**nothing, "R": 0.1}
    for name, first, found in (("a", nothing, "5m"), ("b", glow, "500mm")):
        pixels = [[[first, *samples] for samples in row] for row in rows]
        file = write_deep_samples(tmp_path / f"{name}.exr", pixels)
        ran = succeed("render", file, "-o", tmp_path / name, *LENS[:4], "--focus-at", "20,20")
        assert f"focus {found}" in ran.err


def test_a_volume_lies_at_its_middle_in_one_over_distance(tmp_path):
    color, depth, coverage = layers(1.0)
    volume = from_layers(color, depth, coverage)
    for sample in (each for row in volume for pixel in row for each in pixel):
        sample["ZBack"] = 3.0
    one = rendered(tmp_path, "a", volume, names=("R", "G", "B", "A", "Z", "ZBack"))
    plain = from_layers(color, depth * 0 + np.float32(1.5), coverage)
    assert torch.equal(one, rendered(tmp_path, "b", plain))


def test_more_samples_than_layers_are_merged_and_that_is_said(tmp_path):
    many = np.linspace(3.0, 3.3, 40)
    color, _, coverage = layers(*many)
    coverage[:], color[:] = 0.05, 0.02
    depth = np.broadcast_to(np.float32(many)[:, None, None], coverage.shape)
    samples = from_layers(color, depth, coverage)
    shown = rendered(tmp_path, "a", samples, light="float")[:, 12:-12, 12:-12]
    assert "merged" in (tmp_path / "a" / "journal.jsonl").read_text()
    assert (shown[3] - (1 - 0.95**40)).abs().max() < 1e-3
    assert (shown[0] / shown[3] - 0.4).abs().max() < 1e-3


def test_info_tells_samples_and_their_depths(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    told = run("info", file).out
    count = int((coverage > 0).sum())
    assert "deep" in told
    assert "2 samples a pixel at most" in told
    assert f"{count} samples" in told
    assert "Z 1 to 5" in told


def test_what_makes_no_deep_picture_is_refused(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    coverage[:, 20, 30] = 0.5
    wrong = np.array(depth)
    wrong[1, 20, 30] = np.nan
    bad = write_deep_samples(tmp_path / "bad.exr", from_layers(color, wrong, coverage))
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    few = (color[..., :9], depth[..., :9], coverage[..., :9])
    small = write_deep_samples(tmp_path / "s.exr", from_layers(*few))
    flat = write_exr(tmp_path / "z.exr", Z=np.ones(SIZE, np.float32))
    for words, at, code in (
        ((bad,), bad, "not-finite"),
        ((file, flat), file, "deep-data"),
        ((file, "--holdout", flat), flat, "empty"),
        ((file, "--holdout", small), small, "wrong-size"),
    ):
        refused_input(run("render", *words, "-o", tmp_path / "out", *LENS), at, code)


def test_a_holdout_cuts_out_what_lies_behind_it(tmp_path):
    color, depth, coverage = layers(0.8, 3.0, 6.0)
    coverage[:] = 0
    coverage[0, :, 30:], coverage[1, 8:32, 8:48], coverage[2, :, :30] = 1.0, 0.8, 0.9
    color = np.full_like(color, 0.5) * coverage[:, None]
    own, others = (
        [plane[k] for plane in (color, depth, coverage)] for k in (np.s_[1:2], np.s_[::2])
    )
    cut = write_deep_samples(tmp_path / "cut.exr", from_layers(*others), ("A", "Z"))
    shown = rendered(tmp_path, "a", from_layers(*own), "--holdout", cut, light="float")
    shown = shown[:, 6:-6, 6:-6]
    lit = np.stack([color[:, 0] * 0, coverage * np.float32([0, 1, 0])[:, None, None]], 1)
    lit[1, 0] = color[1, 0]
    assert psnr(shown[[0, 3]], truth(lit, depth, coverage)[:2]) > 40
    assert shown[3, :, 36:].max() < 0.01


def test_a_holdout_cuts_a_flat_picture_too(tmp_path):
    made = layers(1.0)
    planes = {name: np.full(SIZE, 0.5, np.float32) for name in "RGB"}
    planes |= {"A": np.ones(SIZE, np.float32), "Z": np.full(SIZE, 2.0, np.float32)}
    flat = write_exr(tmp_path / "a.exr", **planes)
    cut = write_deep_samples(tmp_path / "cut.exr", from_layers(*made), light="float")
    succeed("render", flat, "-o", tmp_path / "out", *LENS, *FLOAT, "--holdout", cut)
    alpha = picture(tmp_path / "out/render/a.exr")[3]
    assert psnr(alpha[6:-6, 6:-6], 1 - truth(*made)[3]) > 43
