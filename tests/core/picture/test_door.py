"""The door of the library: read, Picture, Lens, render, Views."""

import pickle

import numpy as np
import pytest
import torch
from command_line import succeed
from elements import SIZE, disc, element, write
from image_files import save

import defocus_core as df

LENS = {"focal_length": "120mm", "fnumber": 1.2, "focus": "1m"}
WORDS = ("--focal-length", "120mm", "--fnumber", "1.2", "--focus", "1m")
NEAR, FAR = 0.9, 1.6  # metres
COLOR = np.random.default_rng(5).uniform(0, 1, (*SIZE, 3)).astype(np.float32)
DEPTH = np.where(disc() > 0.5, NEAR, FAR).astype(np.float32)


@pytest.fixture
def files(tmp_path):
    planes = dict(zip("RGB", np.moveaxis(COLOR, 2, 0), strict=True))
    return write(tmp_path / "rgb.exr", planes), write(tmp_path / "depth.exr", {"Z": DEPTH})


def test_what_is_written_is_what_the_command_writes_byte_by_byte(files, tmp_path):
    views = df.render(df.read(*files), df.Lens(**LENS, blades=6), left_right=True)
    written = views.write(tmp_path / "door")
    every = "render,left,right,coc"
    succeed("render", *files, "-o", tmp_path / "cli", *WORDS, "--blades", 6, "--outputs", every)
    assert sorted(written) == sorted(every.split(","))
    for kind, path in written.items():
        assert path.read_bytes() == (tmp_path / "cli" / kind / "rgb.exr").read_bytes(), kind


def test_an_element_over_its_plate_is_that_of_the_command(tmp_path):
    alpha = disc()
    own = element(alpha, depth=NEAR) | dict.fromkeys("RGB", alpha * 0.5)
    plate = {name: np.full(SIZE, 0.2, np.float32) for name in "RGB"}
    plate["Z"] = np.full(SIZE, FAR, np.float32)
    ball, below = write(tmp_path / "ball.exr", own), write(tmp_path / "plate.exr", plate)
    path = df.render(df.read(ball, over=below), df.Lens(**LENS)).write(tmp_path / "a.exr", "render")
    succeed("render", ball, "-o", tmp_path / "b.exr", *WORDS, "--over", below)
    assert path["render"].read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize("make", [np.asarray, torch.from_numpy])
def test_arrays_and_tensors_are_what_their_files_are(files, make):
    lens = df.Lens(**LENS)
    read = df.render(df.read(*files), lens)
    held = df.render(df.Picture(make(COLOR), make(DEPTH)), lens)
    assert np.array_equal(read.render, held.render)
    assert np.array_equal(held.coc, lens.coc(DEPTH))
    assert (held.coc[DEPTH < 1] < 0).all()
    assert (held.coc[DEPTH > 1] > 0).all()


def test_integers_in_memory_are_what_a_png_of_them_is(tmp_path):
    color, depth = (COLOR * 255).astype(np.uint8), (DEPTH * 1000).astype(np.uint16)
    files = save(tmp_path / "a.png", color), save(tmp_path / "d.png", depth[..., None])
    lens = df.Lens(**LENS)
    held = df.Picture(color, depth, depth_unit="mm")
    assert np.array_equal(df.render(df.read(*files), lens).render, df.render(held, lens).render)
    with pytest.raises(df.InputError, match="unit is unknown"):
        df.render(df.Picture(color, depth), lens)


def test_a_matte_and_what_is_hidden_in_memory_are_what_their_files_are(files, tmp_path):
    matte, lens = disc(), df.Lens(**LENS)
    other = COLOR[:, ::-1].copy()
    far = np.full(SIZE, 2.0, np.float32)
    behind = dict(zip("RGB", np.moveaxis(other, 2, 0), strict=True)) | {"Z": far}
    paths = save(tmp_path / "m.png", (matte * 255).astype(np.uint8)[..., None])
    held = write(tmp_path / "behind.exr", behind)
    for read, arrays in (
        ({"matte": paths}, {"matte": (matte * 255).astype(np.uint8)}),
        ({"hidden": (held, held)}, {"hidden": (other, far)}),
    ):
        first = df.render(df.read(*files, **read), lens)
        second = df.render(df.Picture(COLOR, DEPTH, **arrays), lens)
        assert np.array_equal(first.render, second.render)
        assert not np.array_equal(first.render, df.render(df.read(*files), lens).render)


def test_a_lens_is_focused_again_and_a_file_of_it_is_below_options():
    lens = df.Lens(**LENS)
    near = lens.coc(DEPTH)
    lens.refocus(f"{FAR:g}m")
    assert abs(lens.coc(DEPTH)[DEPTH > 1]).max() < 1e-3 < abs(near[DEPTH > 1]).min()
    far = lens.coc(DEPTH)
    lens.refocus(df.Picture(COLOR, DEPTH).at(0, 0).depth)
    assert np.allclose(lens.coc(DEPTH), far, atol=1e-4)
    shipped = df.Lens.load("@portrait-85", focus="2m")
    wide = df.Lens.load("@portrait-85", focus="2m", fnumber=8)
    assert abs(wide.coc(DEPTH)).max() < abs(shipped.coc(DEPTH)).max()


def test_views_are_named_printed_pickled_and_made_tensors():
    picture = df.Picture(COLOR, DEPTH)
    views = df.render(picture, df.Lens(**LENS))
    assert views.left is None
    assert views.trust.shape == SIZE
    height, width = SIZE
    assert repr(picture) == f"<Picture {width}×{height} RGB, depth {NEAR}–{FAR} m, in memory>"
    assert "render" in repr(views)
    assert "fnumber=1.2" in repr(df.Lens(**LENS))
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert views._repr_png_().startswith(b"\x89PNG")
    again = pickle.loads(pickle.dumps((picture, views)))
    assert np.array_equal(again[0].color, COLOR)
    assert np.array_equal(again[1].render, views.render)
    tensors = views.to("cpu")
    assert torch.equal(tensors.render, torch.from_numpy(views.render).movedim(2, 0))
    assert torch.equal(tensors.coc, torch.from_numpy(views.coc))
    assert picture.at(3, 2).depth == DEPTH[2, 3]
    assert picture.to("cpu").device == "cpu"
    assert views.disparity.shape == SIZE
    with pytest.raises(TypeError, match=r"views\.render"):
        _, _ = views
    with pytest.raises(IndexError, match="outside"):
        picture.at(width, 0)


def test_relative_depth_needs_a_blur_and_not_optics():
    near = (255 * (DEPTH < 1)).astype(np.uint8)
    picture = df.Picture(COLOR, near)
    assert picture.is_relative
    metric = df.Picture(COLOR, DEPTH)
    df.render(metric, df.Lens(blur="6px", focus_value=NEAR))
    assert np.array_equal(metric.depth, DEPTH), "a lens of relative depth leaves a picture as it is"
    views = df.render(picture, df.Lens(blur="6px", focus_value=255))
    assert np.isclose(abs(views.coc).max(), 6.0)
    both = [df.render(df.Picture(COLOR, numbers)).coc for numbers in (near, 255 - near)]
    assert (abs(both[0][DEPTH < 1]) < abs(both[0]).max()).all(), "the subject is in focus"
    assert np.allclose(*both), "whichever end is near"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: df.Lens("50mm", fnumbr=2), "did you mean fnumber"),
        (lambda: df.Lens(50), "has no unit"),
        (lambda: df.Lens("50mm", 1.4).coc(DEPTH), "focus"),
        (lambda: df.Picture(COLOR, DEPTH, depth_unit="furlong"), "depth-unit"),
        (lambda: df.Picture(COLOR, DEPTH[:7]), "another aspect|of the size"),
        (lambda: df.Picture(COLOR, DEPTH[None]), r"depth \[H, W\], got"),
        (lambda: df.Picture(COLOR, DEPTH, matte=2 * DEPTH), "matte must be.* in 1.8 to 3.2"),
        (lambda: df.Picture(COLOR, np.ma.masked_less(DEPTH, 1)), "got masked"),
        (lambda: df.compare_images(COLOR, np.ma.masked_less(COLOR, 0.5)), "got masked"),
        (lambda: df.compare_images(torch.ones(3, 4, 4).bfloat16(), COLOR), "arrays of numbers: "),
        (lambda: df.write_image("a.png", (255 * COLOR).astype(np.uint8)), "floats, got uint8"),
        (lambda: df.write_map("a.exr", DEPTH + 1j), "got complex"),
        (lambda: df.RandomDefocus()(COLOR, DEPTH, [1]), "image must be a tensor"),
        (lambda: df.Picture(torch.from_numpy(COLOR).bfloat16(), DEPTH), "arrays of numbers: "),
        (lambda: df.Picture(torch.from_numpy(COLOR), torch.empty(SIZE, device="meta")), "meta"),
        (lambda: df.Picture(COLOR.astype(np.uint32), DEPTH), "uint8 or uint16"),
        (lambda: df.Picture(COLOR, DEPTH, hidden=(COLOR[..., :1], DEPTH)), "hidden must be"),
        (lambda: df.render(df.Picture(COLOR, DEPTH), df.Lens(**LENS), lft_right=1), "left_right"),
        (lambda: df.Picture(COLOR, np.full(SIZE, "a")), "arrays of numbers"),
        (lambda: df.Picture(COLOR.astype(np.int32), DEPTH), "uint8 or uint16"),
        (lambda: df.render(df.Picture(COLOR, DEPTH), 2.0), "must be a Lens"),
        (lambda: df.render(df.Picture(COLOR, DEPTH), df.Lens(**LENS), quality="best"), "quality"),
        (lambda: df.read("nowhere.exr"), "no such file"),
    ],
)
def test_what_makes_no_sense_is_refused(call, words):
    with pytest.raises((df.DefocusError, ValueError), match=words):
        call()


def test_no_file_is_replaced_unless_that_is_said(files, tmp_path):
    views = df.render(df.read(*files), df.Lens(**LENS))
    path = views.write(tmp_path / "out", "render")["render"]
    before = path.read_bytes()
    with pytest.raises(df.InputError, match="exists already"):
        views.write(tmp_path / "out", "render")
    views.write(tmp_path / "out", "render", overwrite=True, exr_type="float")
    assert path.read_bytes() != before
    with pytest.raises(df.InputError, match="is an input"):
        views.write(files[0], "render", overwrite=True)
    with pytest.raises(df.UsageProblem, match="was not rendered"):
        views.write(tmp_path / "more", "left")
    bright = df.render(df.Picture(COLOR * 9, DEPTH), df.Lens(**LENS))
    with pytest.warns(UserWarning, match="brighter than white") as said:
        bright.write(tmp_path / "bright.png", "render")
    assert said[0].filename == __file__
    assert any("brighter" in words for words in bright.warnings)
