"""`--noise match`: what is blurred gets the noise that the photograph has where it is sharp."""

import numpy as np
import pytest

import defocus_core as df

SIZE = 256, 512
A, B = 2e-6, 6e-5  # variance of the noise: A + B light
HALF = slice(20, 236), slice(0, 256)  # sharp
OTHER = slice(20, 236), slice(300, 500)  # blurred


@pytest.fixture(scope="module")
def picture():
    """A slope of light with noise, in focus in its left half, blurred in its right one."""
    light = np.linspace(0.02, 0.8, SIZE[0])[:, None, None] * np.ones((*SIZE, 3))
    random = np.random.default_rng(3).standard_normal(light.shape)
    depth = np.full(SIZE, 2, np.float32)
    depth[:, SIZE[1] // 2 :] = 8
    return df.Picture((light + np.sqrt(A + B * light) * random).astype(np.float32), depth)


def written(picture, out, **options):
    views = df.render(picture, df.Lens("50mm", 1.4, "2m", **options), left_right=True)
    views.write(out, "render,left,right", exr_type="float")
    return {kind: df.read_color(out / kind / "picture.exr").pixels for kind in ("render", "left")}


def sigma(pixels, rows):
    """The noise in some rows of a slope."""
    part = pixels[rows]
    return float((part - part.mean(1, keepdims=True)).std())


@pytest.mark.parametrize("first", [20, 90, 160])
def test_the_noise_is_alike_in_sharp_and_blurred_parts_by_brightness(picture, tmp_path, first):
    pixels = written(picture, tmp_path, noise="match")
    rows = slice(first, first + 60)
    sharp, blurred = (sigma(pixels["render"], (rows, part[1])) for part in (HALF, OTHER))
    assert blurred == pytest.approx(sharp, rel=0.1)
    assert sigma(pixels["left"], (rows, OTHER[1])) == pytest.approx(sharp, rel=0.1)


def test_what_is_sharp_stays_and_the_same_seed_gives_the_same(picture, tmp_path):
    plain, one, two, other = (
        written(picture, tmp_path / str(n), **options)
        for n, options in enumerate(
            [{}, {"noise": "match"}, {"noise": "match"}, {"noise": "match", "noise_seed": 1}]
        )
    )
    assert np.array_equal(one["render"][HALF], plain["render"][HALF])
    assert np.array_equal(one["render"], two["render"])
    assert not np.array_equal(one["render"], other["render"])
    assert not np.array_equal(one["render"] - plain["render"], one["left"] - plain["left"])


def test_a_picture_without_a_flat_and_sharp_place_is_refused(tmp_path):
    picture = df.Picture(np.ones((64, 64, 3), np.float32), np.full((64, 64), 9, np.float32))
    with pytest.raises(df.InputError, match="ELECTRONS:READ"):
        written(picture, tmp_path, noise="match")
