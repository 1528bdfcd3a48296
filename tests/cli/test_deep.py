"""Deep EXR: the samples of each pixel are layers; what they say is rendered, and no more."""

import numpy as np
import pytest
import torch
from command_line import photograph, read_exr, refused_input, render, run, write_exr
from deep_files import from_layers, write_deep_samples
from layers import brute_force
from measures import psnr

from defocus_core import DefocusLens

SIZE = (40, 56)
LENS = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "2m")
FLOAT = ("--exr-type", "float")


def layers(*metres, seed=0):
    """A layer with a soft round card for each depth: premultiplied colours, depth, coverage."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    coverage = np.stack(
        [
            np.clip(9 - np.hypot(y - row, x - column), 0, 1) * 0.75
            for row, column in 12 + rng.random((len(metres), 2)) * (16, 32)
        ]
    ).astype(np.float32)
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
    planes = (
        [rgba[name] for name in "RGBA"] if "R" in rgba else list(np.moveaxis(rgba["RGBA"], 2, 0))
    )
    return torch.from_numpy(np.stack(planes).astype(np.float64))


@pytest.mark.parametrize(("light", "tile"), [("half", 0), ("float", 0), ("float", 16)])
def test_a_deep_picture_is_near_the_brute_force_one(tmp_path, light, tile):
    color, depth, coverage = layers(0.8, 2.0, 6.0)
    file = write_deep_samples(
        tmp_path / "a.exr", from_layers(color, depth, coverage), light=light, tile=tile
    )
    render(file, "-o", tmp_path / "out", *LENS, *FLOAT)
    truth = brute_force(torch.from_numpy(color), radius_of(depth), torch.from_numpy(coverage), 512)
    shown = picture(tmp_path / "out/render/a.exr")
    assert psnr(shown[:, 6:-6, 6:-6], truth[:, 6:-6, 6:-6]) > 40


def test_samples_may_come_in_any_order_and_outside_windows_is_nothing(tmp_path):
    color, depth, coverage = layers(0.9, 4.0)
    forward = from_layers(color, depth, coverage)
    backward = [[pixel[::-1] for pixel in row] for row in forward]
    for name, pixels in (("a", forward), ("b", backward)):
        file = write_deep_samples(
            tmp_path / f"{name}.exr", pixels, corner=(3, 5), full=(SIZE[1] + 8, SIZE[0] + 9)
        )
        render(file, "-o", tmp_path / name, *LENS, *FLOAT)
    one, other = (picture(tmp_path / f"{n}/render/{n}.exr") for n in "ab")
    assert one.shape == (4, SIZE[0] + 9, SIZE[1] + 8)
    assert torch.equal(one, other)


def test_coc_and_focus_are_those_of_the_first_surface(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    coverage[:] = 0
    coverage[1, 10:30, 10:40] = coverage[0, 10:30, 10:30] = 0.5
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    ran = render(
        file, "-o", tmp_path / "out", *LENS[:4], "--focus", "percentile(50)", "--outputs", "coc"
    )
    assert "focus 1m" in ran.out + ran.err
    coc = read_exr(tmp_path / "out/coc/a.exr")["coc"]
    assert not coc[10:30, 10:30].any()
    assert (coc[10:30, 30:40] > 0.8).all()
    assert not coc[:8].any()


def test_a_volume_lies_at_its_middle_in_one_over_distance(tmp_path):
    color, depth, coverage = layers(1.0)
    pixels = from_layers(color, depth, coverage)
    for row in pixels:
        for samples in row:
            for sample in samples:
                sample["ZBack"] = 3.0
    names = ("R", "G", "B", "A", "Z", "ZBack")
    render(write_deep_samples(tmp_path / "a.exr", pixels, names), "-o", tmp_path / "a", *LENS)
    plain = from_layers(color, depth * 0 + np.float32(1.5), coverage)
    render(write_deep_samples(tmp_path / "b.exr", plain), "-o", tmp_path / "b", *LENS)
    one, other = (picture(tmp_path / f"{n}/render/{n}.exr") for n in "ab")
    assert torch.equal(one, other)


def test_more_samples_than_layers_are_merged_and_that_is_said(tmp_path):
    many = np.linspace(3.0, 3.3, 40)
    color, _, coverage = layers(*many)
    coverage[:], color[:] = 0.05, 0.02
    depth = np.broadcast_to(np.float32(many)[:, None, None], coverage.shape)
    file = write_deep_samples(
        tmp_path / "a.exr", from_layers(color, depth, coverage), light="float"
    )
    ran = render(file, "-o", tmp_path / "out", *LENS, *FLOAT, "--json")
    assert "merged" in ran.out
    shown = picture(tmp_path / "out/render/a.exr")[:, 12:-12, 12:-12]
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


def test_a_sample_without_depth_is_named(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    coverage[:, 20, 30] = 0.5
    wrong = np.array(depth)
    wrong[1, 20, 30] = np.nan
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, wrong, coverage))
    refused_input(render(file, "-o", tmp_path / "out", *LENS), file, "not-finite")


def test_a_depth_file_beside_a_deep_picture_is_refused(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    other = write_exr(tmp_path / "z.exr", Z=np.ones(SIZE, np.float32))
    refused_input(render(file, other, "-o", tmp_path / "out", *LENS), file, "deep-data")


def test_a_holdout_cuts_out_what_lies_behind_it(tmp_path):
    color, depth, coverage = layers(0.8, 3.0, 6.0)
    coverage[:] = 0
    coverage[0, :, 30:], coverage[1, 8:32, 8:48], coverage[2, :, :30] = 1.0, 0.8, 0.9
    color = np.full_like(color, 0.5) * coverage[:, None]
    file = write_deep_samples(
        tmp_path / "a.exr", from_layers(color[1:2], depth[1:2], coverage[1:2]), light="float"
    )
    cut = write_deep_samples(
        tmp_path / "cut.exr", from_layers(color[::2], depth[::2], coverage[::2]), ("A", "Z")
    )
    render(file, "-o", tmp_path / "out", *LENS, *FLOAT, "--holdout", cut)
    shown = picture(tmp_path / "out/render/a.exr")[:, 6:-6, 6:-6]
    inputs = torch.from_numpy(color), radius_of(depth), torch.from_numpy(coverage)
    lit = torch.stack([inputs[0][:, 0] * 0, inputs[2] * torch.tensor([0, 1, 0])[:, None, None]], 1)
    lit[1, 0] = inputs[0][1, 0]
    truth = brute_force(lit, *inputs[1:], 512)[:2, 6:-6, 6:-6]
    assert psnr(shown[[0, 3]], truth) > 40
    assert shown[3, :, 36:].max() < 0.01


def test_a_holdout_cuts_a_flat_picture_too(tmp_path):
    color, depth, coverage = layers(1.0)
    flat_file = write_exr(
        tmp_path / "a.exr",
        **{name: np.full(SIZE, 0.5, np.float32) for name in "RGB"},
        A=np.ones(SIZE, np.float32),
        Z=np.full(SIZE, 2.0, np.float32),
    )
    cut = write_deep_samples(
        tmp_path / "cut.exr", from_layers(color, depth, coverage), light="float"
    )
    render(flat_file, "-o", tmp_path / "out", *LENS, *FLOAT, "--holdout", cut)
    blurred = brute_force(
        torch.from_numpy(color), radius_of(depth), torch.from_numpy(coverage), 512
    )[3]
    alpha = picture(tmp_path / "out/render/a.exr")[3]
    assert psnr(alpha[6:-6, 6:-6], 1 - blurred[6:-6, 6:-6]) > 43


def test_a_holdout_that_is_not_deep_or_of_another_size_is_refused(tmp_path):
    color, depth, coverage = layers(1.0, 5.0)
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage))
    flat_file = write_exr(tmp_path / "z.exr", Z=np.ones(SIZE, np.float32))
    refused = render(file, "-o", tmp_path / "out", *LENS, "--holdout", flat_file)
    refused_input(refused, flat_file, "empty")
    small = write_deep_samples(
        tmp_path / "s.exr", from_layers(color[..., :9], depth[..., :9], coverage[..., :9])
    )
    refused = render(file, "-o", tmp_path / "out", *LENS, "--holdout", small)
    refused_input(refused, small, "wrong-size")


def test_a_deep_picture_over_a_plate_is_the_scene_of_both(tmp_path):
    color, depth, coverage = layers(0.9, 3.0, 6.0)
    color[2], coverage[2] = 0.4, 1.0
    whole = from_layers(color, depth, coverage)
    render(
        write_deep_samples(tmp_path / "whole.exr", whole, light="float"),
        "-o",
        tmp_path / "whole_out",
        *LENS,
        *FLOAT,
    )
    front = from_layers(color[:2], depth[:2], coverage[:2])
    file = write_deep_samples(tmp_path / "a.exr", front, light="float")
    plate = write_exr(
        tmp_path / "plate.exr",
        **{name: color[2, k] for k, name in enumerate("RGB")},
        Z=np.array(depth[2]),
    )
    render(file, "-o", tmp_path / "out", *LENS, *FLOAT, "--over", plate)
    one, other = (
        picture(tmp_path / "out/render/a.exr"),
        picture(tmp_path / "whole_out/render/whole.exr"),
    )
    assert (one - other).abs().max() < 1e-4
    assert (one[3] == 1).all()


def test_rows_without_samples_are_nothing(tmp_path):
    color, depth, coverage = layers(0.8, 2.0, 6.0)
    coverage[:, 16:] = 0
    file = write_deep_samples(tmp_path / "a.exr", from_layers(color, depth, coverage), tile=16)
    photograph(file, "-o", tmp_path / "b", *LENS)
    assert float(picture(tmp_path / "b/render/a.exr")[-1, -4:].max()) == 0
    coverage[:] = 0
    file = write_deep_samples(tmp_path / "none.exr", from_layers(color, depth, coverage))
    photograph(file, "-o", tmp_path / "c", *LENS)
    assert float(picture(tmp_path / "c/render/none.exr").abs().max()) == 0


@pytest.mark.parametrize("view", ["left", "right"])
def test_a_deep_picture_of_two_views_in_one_part_renders_each(tmp_path, view):
    """Both views have as many samples in a pixel: those of one part share their numbers."""
    made = {"left": layers(2.0, 4.0), "right": layers(1.5, 3.0)}
    samples = {each: from_layers(*made[each]) for each in made}
    both = [
        [
            [
                {f"{each}.{n}": v for each in made for n, v in samples[each][y][x][k].items()}
                for k in range(len(samples["left"][y][x]))
            ]
            for x in range(SIZE[1])
        ]
        for y in range(SIZE[0])
    ]
    names = [f"{each}.{name}" for each in made for name in "RGBAZ"]
    deep = write_deep_samples(
        tmp_path / "deep.exr", both, names, light="float", views=("left", "right")
    )
    own = write_deep_samples(tmp_path / "alone.exr", samples[view], light="float")
    photograph(deep, "-o", tmp_path / "a", "--view", view, *LENS)
    photograph(own, "-o", tmp_path / "b", *LENS)
    of_both, alone = tmp_path / "a/render/deep.exr", tmp_path / "b/render/alone.exr"
    assert torch.equal(picture(of_both), picture(alone))
