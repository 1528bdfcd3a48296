"""Any size, dtype, channel count and radius; what is wrong is refused at the door."""

import math
from typing import Any

import pytest
import torch
from measures import worst
from scenes import checkerboard, pattern, slanted
from tolerances import RENDERED, WHITE
from torch import Tensor

from defocus_core import QUALITIES, Aperture, DefocusLens, RandomDefocus, render

IMAGE, RADIUS = pattern().float(), slanted().float()
# a picture rounded to this dtype is computed in float32 and rounded again
HALVES = {torch.float16: 2.0**-11, torch.bfloat16: 2.0**-8}


def spread(size: tuple[int, ...], maximum: float) -> Tensor:
    """Independent radii from -most to most px."""
    return maximum * (2 * torch.rand(size, generator=torch.Generator().manual_seed(2)) - 1)


@pytest.mark.parametrize("maximum", [0.0, 0.4, 1.0, 3.0, 30.0, 300.0, 1e5])
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 3), (1, 120), (33, 17)])
def test_white_stays_white_in_any_frame_at_any_radius(
    size: tuple[int, int], maximum: float
) -> None:
    for radius in (spread(size, maximum), torch.full(size, maximum), torch.full(size, -maximum)):
        o = render(torch.ones(1, *size), radius, left_right=True)
        for picture in (o.render, o.left, o.right):
            assert picture is not None
            assert worst(picture, 1.0) < WHITE


@pytest.mark.parametrize("light", [-1.0, 1e30, -1e30])
@pytest.mark.parametrize("quality", QUALITIES)
def test_even_light_of_any_sign_stays_even(quality: str, light: float) -> None:
    """Negative light, which wide colours have, was once taken for highlights in a draft."""
    radius = spread((32, 48), 6.0)
    o = render(torch.full((3, 32, 48), light), radius, quality=quality, left_right=True)
    for picture in (o.render, o.left, o.right):
        assert picture is not None
        assert worst(picture / light, 1.0) < WHITE


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_brightest_pixel_that_is_taken_makes_no_sum_overflow(quality: str) -> None:
    image = IMAGE.clone()
    image[:, 20, 20] = 1e30
    o = render(image, RADIUS, quality=quality, left_right=True)
    for picture in (o.render, o.left, o.right):
        assert picture is not None
        assert bool(torch.isfinite(picture).all())


@pytest.mark.parametrize(("near", "far"), [(-1.6, 0.3), (-2.5, 0.0), (-4.0, -2.5), (6.5, 8.0)])
@pytest.mark.parametrize("size", [(9, 12), (1, 40)])
def test_white_stays_white_where_nothing_is_much_farther_than_a_card(
    size: tuple[int, int], near: float, far: float
) -> None:
    """What lies behind it has to be taken from a background that is hardly farther."""
    radius = torch.full(size, far)
    radius[:, size[1] // 2 :] = near
    assert worst(render(torch.ones(1, *size), radius).render, 1.0) < WHITE


@pytest.mark.parametrize("dtype", HALVES)
@pytest.mark.parametrize("radius_dtype", [torch.float16, torch.float32])
def test_half_precision_is_computed_in_float32(
    dtype: torch.dtype, radius_dtype: torch.dtype
) -> None:
    image, radius = IMAGE.to(dtype), RADIUS.to(radius_dtype)
    picture = render(image, radius).render
    assert picture.dtype == dtype
    exact = render(image.float(), radius.float()).render
    assert worst(picture, exact.double()) <= HALVES[dtype]


def test_float32_is_float64_rounded() -> None:
    wide = render(IMAGE.double(), RADIUS.double())
    assert wide.render.dtype == torch.float64
    assert worst(render(IMAGE, RADIUS).render, wide.render) < RENDERED[torch.float32]


@pytest.mark.parametrize("shape", [(40, 56), (1, 40, 56), (1, 1, 40, 56)])
def test_radii_of_one_picture_come_in_any_documented_shape(shape: tuple[int, ...]) -> None:
    one = render(IMAGE, RADIUS.reshape(shape)).render
    assert one.shape == IMAGE.shape
    batch = render(IMAGE[None], RADIUS.reshape(shape)).render
    assert batch.shape == (1, *IMAGE.shape)
    assert torch.equal(batch[0], one)
    assert torch.equal(one, render(IMAGE, RADIUS).render)


def test_a_batch_of_no_picture_has_no_views() -> None:
    image, depth = torch.zeros(0, 3, 40, 56), torch.ones(0, 40, 56)
    every = [render(image, depth, left_right=True), RandomDefocus()(image, depth, [])[0]]
    every += [render(image, depth[:, None])]
    for views in every:
        assert {tuple(view.shape) for view in views.images} == {(0, 3, 40, 56)}
        assert views.trust.shape == (0, 1, 40, 56)
    lens = DefocusLens(50.0, 2.0, device="cpu")
    lens.refocus(2000.0)
    assert lens.render_rgbd(image, depth).shape == (0, 3, 40, 56)


def test_inputs_are_left_as_they_were() -> None:
    image, radius = IMAGE.clone(), RADIUS.clone()
    render(image, radius, left_right=True)
    assert torch.equal(image, IMAGE)
    assert torch.equal(radius, RADIUS)


def test_a_constant_factor_passes_through() -> None:
    """Light is linear: 4096 times as bright is 4096 times the picture, bit for bit."""
    radius = checkerboard().float()
    assert torch.equal(render(4096 * IMAGE, radius).render, 4096 * render(IMAGE, radius).render)


def test_alpha_is_blurred_as_any_channel() -> None:
    alpha = (pattern()[:1] > 0.5).float()
    picture = render(torch.cat([IMAGE * alpha, alpha]), RADIUS).render
    assert torch.equal(picture[3:], render(alpha, RADIUS).render)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 40])
def test_num_layers_is_honoured(count: int) -> None:
    o = render(IMAGE, RADIUS, num_layers=count)
    assert o.stats["slices"] == count
    assert worst(render(torch.ones_like(IMAGE), RADIUS, num_layers=count).render, 1.0) < WHITE


def test_more_layers_come_closer() -> None:
    fine = render(IMAGE, RADIUS, num_layers=121).render
    errors = [worst(render(IMAGE, RADIUS, num_layers=n).render, fine) for n in (1, 4, 16, 61)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < errors[0] / 20


def test_psf_ks_that_fits_changes_nothing() -> None:
    assert worst(render(IMAGE, RADIUS, psf_ks=19).render, render(IMAGE, RADIUS).render) < 2e-6


@pytest.mark.parametrize(("r", "needed"), [(9.0, 19), (-9.0, 19), (0.3, 1), (3.6, 9), (3.4, 7)])
def test_psf_ks_that_does_not_fit_names_the_size_needed(r: float, needed: int) -> None:
    radius = torch.full_like(RADIUS, r)
    render(IMAGE, radius, psf_ks=needed)
    if needed > 1:
        with pytest.raises(ValueError, match=f"at least {needed} .*got {needed - 2}"):
            render(IMAGE, radius, psf_ks=needed - 2)


def test_the_lens_passes_psf_ks_and_num_layers_on() -> None:
    lens = DefocusLens(200.0, 2.0, (36.0, 36.0 * 40 / 56), (56, 40))  # -10.6 and 5.2 px below
    lens.refocus(2000.0)
    depth = torch.full((1, 1, 40, 56), 900.0)
    depth[..., 28:] = 5000.0
    fitting = lens.render_rgbd(IMAGE[None], depth, psf_ks=65)
    assert worst(fitting, lens.render_rgbd(IMAGE[None], depth).double()) < 2e-6
    assert worst(fitting, lens.render_rgbd(IMAGE[None], depth, num_layers=1).double()) > 0.01
    with pytest.raises(ValueError, match="psf_ks must be at least"):
        lens.render_rgbd(IMAGE[None], depth, psf_ks=3)


def test_progress_counts_tiles() -> None:
    calls: list[tuple[int, int]] = []
    o = render(
        torch.ones(1, 150, 200),
        torch.zeros(150, 200),
        progress=lambda done, total: calls.append((done, total)),
    )
    count = o.stats["tiles"]
    assert calls == [(k + 1, count) for k in range(count)]


WRONG: list[tuple[str, dict[str, Any]]] = [
    ("image must be", {"image": IMAGE[0]}),
    ("image must be", {"image": (255 * IMAGE).to(torch.uint8)}),
    ("decode integers to linear light", {"image": (255 * IMAGE).to(torch.uint8)}),
    ("torch.from_numpy makes a tensor", {"image": IMAGE.numpy()}),
    ("one image is image.None, None", {"image": IMAGE[0]}),
    ("several batches are image.flatten", {"image": IMAGE[None, None]}),
    (r"image.movedim\(-1, -3\)", {"image": IMAGE.movedim(0, -1)}),
    (r"rows and columns come last, signed_radius\[..., 0\]", {"signed_radius": RADIUS[..., None]}),
    ("resample it to .* by nearest", {"signed_radius": RADIUS[:-1]}),
    ("give one map for each of 2 pictures", {"image": torch.stack([IMAGE, IMAGE])}),
    ("infinity must be one radius, or one for each of 1", {"infinity": [1.0, 2.0]}),
    ("image must hold a pixel", {"image": IMAGE[:, :0], "signed_radius": RADIUS[:0]}),
    ("image must be finite", {"image": IMAGE / 0.0}),
    ("image must be within ±1e", {"image": IMAGE * 3e38}),
    ("image must be within ±1e", {"image": -IMAGE * 3e38}),
    ("signed_radius must be", {"signed_radius": RADIUS.T}),
    ("signed_radius must be", {"signed_radius": RADIUS[None, None, None]}),
    ("signed_radius must be", {"image": torch.stack([IMAGE, IMAGE])}),
    ("signed_radius must be finite", {"signed_radius": RADIUS * math.nan}),
    ("signed_radius must be finite", {"signed_radius": RADIUS / 0.0}),
    ("quality must be one of draft, standard", {"quality": "best"}),
    ("num_layers must be at least 1", {"num_layers": 0}),
    ("psf_ks must be at least 1", {"psf_ks": 0}),
    ("threads must be at least 1", {"threads": 0}),
]


@pytest.mark.parametrize(("message", "change"), WRONG)
def test_what_is_wrong_is_refused_by_name(message: str, change: dict[str, Any]) -> None:
    good: dict[str, Any] = {"image": IMAGE, "signed_radius": RADIUS}
    with pytest.raises(ValueError, match=message):
        render(**(good | change))


def test_blades_that_make_no_polygon_are_refused() -> None:
    with pytest.raises(ValueError, match="blades must be 0 or at least 3"):
        render(IMAGE, RADIUS, aperture=Aperture(blades=2))


def test_a_finer_quality_has_more_slices() -> None:
    slices = [render(IMAGE, 3 * RADIUS, quality=q).stats["slices"] for q in QUALITIES]
    assert slices == sorted(set(slices))


@pytest.mark.parametrize("r", [9.0, 70.0, 400.0, 1e5])
def test_two_pixels_far_apart_in_depth_stay_white(r: float) -> None:
    """A border between near and far radii has the far one beyond it."""
    assert worst(render(torch.ones(1, 1, 2), torch.tensor([[-r, r]])).render, 1.0) < WHITE
    odd = (torch.arange(30)[:, None] + torch.arange(30)) % 2
    checkerboard = torch.where(odd == 1, 70.0, -70.0)
    assert worst(render(torch.ones(1, 30, 30), checkerboard).render, 1.0) < WHITE


def test_rounding_beside_a_bright_patch_does_not_show() -> None:
    """A hundredth of the picture is 1e8 times as bright as the rest: too much for highlights."""
    image, radius = torch.full((1, 100, 140), 1e-2), torch.full((100, 140), 0.7)
    image[:, :12, :12] = 1e6
    seen = render(image, radius).render[:, 40:, 40:]
    assert seen.dtype == torch.float32
    assert worst(seen / 1e-2, 1.0) < 1e-4
