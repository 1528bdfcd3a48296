"""A draft: rendered in coarse pixels, enlarged, with the detail of what is in focus."""

import pytest
import torch
from measures import inner, psnr, worst
from reference import flatten, layered, lens_points
from scenes import card_layers
from windows import Windows, put_together, same

from defocus_core import render
from defocus_core.evaluation.synthetic_scenes import scenery
from defocus_core.renderer.engine.drafts import (
    NO_DETAIL,
    coarse_radii,
    doubled,
    in_coarse_pixels,
    left_of_detail,
    means,
)
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.renderer.layers.slice_radii import SHARP
from defocus_core.tensors.box import Box

SIZE = (184, 200)  # large enough to be halved


def noise(*size):
    return torch.rand(size, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def half(x):
    return torch.nn.functional.avg_pool2d(x[None], 2)[0]


def pixels_of(coarse):
    return doubled(coarse, Box(0, 0, *coarse.shape[-2:]))


def test_colours_of_a_coarse_pixel_are_means_whichever_window_asks_for_them():
    image, odd = noise(3, 6, 8), noise(3, 5, 8)
    assert torch.allclose(in_coarse_pixels(means, image)[...], half(image), atol=1e-15)
    coarse, pairs = in_coarse_pixels(means, odd), odd.view(3, 5, 4, 2).mean(-1)
    assert tuple(coarse.shape) == (3, 3, 4)
    assert torch.allclose(coarse[...][:, 1], pairs[:, 1:4].mT @ noise(3).new_tensor([1, 2, 1]) / 4)
    assert torch.allclose(coarse[...].flip(1), in_coarse_pixels(means, odd.flip(1))[...])
    for rows, columns in ((slice(1, 3), slice(0, 2)), (slice(0, 3, 2), slice(1, 4))):
        assert torch.equal(coarse[..., rows, columns], coarse[...][..., rows, columns])


@pytest.mark.parametrize(
    ("px", "light", "expected"),
    [
        ([1.0, 1.2, 1.4, 1.6], [1, 1, 1, 1], 1.3),  # a slope
        ([-5.0, 3.0, 3.2, 3.4], [1, 1, 1, 1], 3.2),  # one px of another surface
        ([-5.0, -5.2, 3.0, 3.4], [0, 0, 0, 0], -5.1),  # the nearer of two
        ([-5.0, -5.2, 3.0, 3.4], [1, 1, 7, 2], 3.2),  # unless nearly all light is beyond it
        ([-5.0, -5.2, -5.1, 30.0], [1, 1, 1, 50], 30.0),
    ],
)
def test_the_radius_of_a_coarse_pixel_is_that_of_the_surface_which_shows(px, light, expected):
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        radius, image = (noise(4).new_tensor([x[i] for i in order]) for x in (px, light))
        image = image.view(1, 2, 2).expand(3, 2, 2)
        coarse = in_coarse_pixels(coarse_radii, radius.view(2, 2), image)
        assert float(coarse[:, :]) == pytest.approx(expected / 2, abs=1e-12)


def test_enlarged_coarse_pixels_stay_means_within_the_range_around_them():
    coarse = 0.5 + noise(2, 3, 9, 11) ** 8  # with contrasts that would ring
    px = pixels_of(coarse)
    assert torch.allclose(half(px.flatten(0, 1)).view_as(coarse), coarse, atol=1e-14)
    assert float(px.min()) >= float(coarse.min()) - 1e-14
    assert float(px.max()) <= float(coarse.max()) + 1e-14
    assert torch.equal(doubled(coarse[..., 2:9, 1:9], Box(2, 2, 3, 4)), px[..., 8:14, 6:14])


@pytest.mark.parametrize("power", [0, 1, 2, 3, 4])
def test_rising_polynomials_of_fourth_order_stay_what_they_are(power):
    """Of a row or a column; means over pixels and over coarse pixels are exact integrals here."""
    x = torch.arange(1, 34, dtype=torch.float64) / 16
    row = 3 + (x[1:] ** (power + 1) - x[:-1] ** (power + 1)) * 16 / (power + 1)
    px, kept = row.expand(1, 32, 32), slice(4, -4)
    enlarged = pixels_of(half(px))
    assert torch.allclose(enlarged[0, kept, kept], px[0, kept, kept], atol=1e-12)
    assert torch.allclose(pixels_of(half(px.mT)).mT, enlarged, atol=1e-15)


def test_a_disc_leaves_less_of_detail_the_larger_it_is():
    left = left_of_detail(noise(8).new_tensor([0.0, SHARP, -0.5, 1.0, -1.5, 2.0, NO_DETAIL, 9.0]))
    assert left[:2].tolist() == [1.0, 1.0]
    assert left[-2:].tolist() == pytest.approx([0.0, 0.0], abs=1e-8)
    assert bool((left.diff()[1:-1] < 0).all())


@pytest.mark.parametrize("size", [(40, 56), (181, 181)])
def test_a_draft_too_small_to_be_halved_is_the_standard(size):
    image, radius = noise(3, *size).float(), torch.linspace(-6, 6, size[1]).expand(size)
    draft, standard = (render(image, radius, quality=q).render for q in ("draft", "standard"))
    assert torch.equal(draft, standard)
    large = [x.repeat(*[1] * (x.dim() - 2), 5, 1) for x in (image, radius)]
    assert Renderer(Scene(*large), Settings(quality="draft")).at_half_size == (size[0] * 5 > 582)


@pytest.mark.parametrize("size", [(200, 201), (185, 200), (1, 40000)])
def test_any_size_is_rendered(size):
    image, radius = noise(2, *size).float(), torch.linspace(-2, 4, size[1]).expand(size)
    views = render(image, radius, quality="draft", left_right=True)
    assert views.render.shape == views.left.shape == image.shape
    assert views.trust.shape == (1, *size)
    assert views.stats["pixels"] == size[0] * size[1]
    assert bool(torch.isfinite(views.render).all())


def test_far_from_focus_a_draft_is_a_picture_of_half_the_size_enlarged():
    image, radius = noise(3, *SIZE).float(), torch.full(SIZE, 6.0)
    draft, standard = (render(image, radius, quality=q).render for q in ("draft", "standard"))
    assert worst(inner(half(draft), 4), inner(half(standard), 4)) < 0.03


def test_a_black_picture_stays_black_and_one_in_focus_is_copied():
    radius = torch.linspace(-3, 3, SIZE[1]).expand(SIZE)
    assert float(render(torch.zeros(3, *SIZE), radius, quality="draft").render.abs().max()) == 0
    image = noise(3, *SIZE).float()
    views = render(image, torch.full(SIZE, 0.14), quality="draft")
    assert torch.equal(views.render, image)
    assert views.stats["pixels_copied"] == SIZE[0] * SIZE[1]


def test_what_is_in_focus_keeps_its_detail_beside_what_is_not():
    image, radius = noise(3, *SIZE).float(), torch.zeros(SIZE)
    radius[:, 100:] = 8.0
    for picture in render(image, radius, quality="draft", left_right=True).images:
        assert worst(picture[..., :90], image[..., :90]) < 1e-6


@pytest.mark.parametrize("r", [-1.0, 0.7])
def test_detail_is_shifted_apart_as_the_halves_are(r):
    """What lies beyond the focus moves to the left in the left image, and the mean stays."""
    x = torch.arange(SIZE[1], dtype=torch.float64)
    image = (0.5 + 0.1 * torch.sin(0.3 * torch.pi * x)).expand(1, *SIZE)
    radius = torch.full(SIZE, r, dtype=torch.float64)
    centre, left, right = render(image, radius, quality="draft", left_right=True).images
    assert torch.allclose((left + right) / 2, centre, atol=1e-12)
    wave = torch.exp(0.3j * torch.pi * x)[20:180]  # whole waves
    late = [(picture[0, 90, 20:180] * wave).sum().angle() for picture in (left, right)]
    assert float((late[1] - late[0]) * r) > 0.02


def test_a_blurred_card_hides_detail_as_far_as_it_covers_it():
    """Against rays through the lens: better than with no detail there, or with all of it."""
    layers = card_layers(-7.0, 0.0, SIZE)
    image, radius = flatten(layers, SIZE)
    truth = layered(layers, lens_points(24), SIZE)
    views = render(image, radius, quality="draft").render
    beside = (radius == 0).expand(views.shape)
    coarse, own = (
        torch.nn.functional.interpolate(half(x)[None], SIZE, mode="bilinear")[0]
        for x in (views, image)
    )
    error = psnr(views[beside], truth[beside])
    assert error > psnr(coarse[beside], truth[beside])
    assert error > psnr((coarse + image - own)[beside], truth[beside])


def test_slices_asked_for_are_those_of_the_picture():
    """Whoever asks for slices or for kernels in px gets them in px."""
    image, radius = noise(3, *SIZE).float(), torch.linspace(-6, 6, SIZE[1]).expand(SIZE)
    for asked in ({"num_layers": 5}, {"psf_ks": 31}):
        draft, standard = (render(image, radius, quality=q, **asked) for q in ("draft", "standard"))
        assert draft.stats["tiles"] == standard.stats["tiles"]
        assert psnr(draft.render, standard.render) > 30
    assert render(image, radius, quality="draft", num_layers=5).stats["slices"] == 5


@pytest.mark.parametrize(("kind", "kept"), [("most", True), ("cards", False)])
def test_a_renderer_of_a_draft_is_its_rendering(kind, kept, request):
    """Also where its coarse pixels are not kept, and where regions end between bands."""
    image, radius = scenery(kind, 1401, 303, 8.0)
    hidden = HiddenLayer(image.flip(-1), radius + 9, radius < radius.mean())
    behind = hidden if kind == "cards" else None
    whole = render(image, radius, quality="draft", left_right=True, hidden=behind)
    if not kept:
        request.getfixturevalue("no_room")
    known = (*map(Windows, hidden),) if behind else None
    scene = Scene(Windows(image), Windows(radius), hidden=known)
    renderer = Renderer(scene, Settings(quality="draft", left_right=True, threads=2))
    assert same(put_together(renderer), whole)
    assert renderer.stats == whole.stats


def test_a_known_layer_shows_its_known_pixels_alone():
    """What is not known may hold anything."""
    image, radius = scenery("cards", 240, 200, 9.0)
    mask = radius < radius.mean()
    unknown = HiddenLayer(
        torch.where(mask, image.flip(-1), 99.0), torch.where(mask, radius + 9, -1), mask
    )
    known = HiddenLayer(torch.where(mask, image.flip(-1), 0.0), radius + 9, mask)
    one, other = (render(image, radius, quality="draft", hidden=x).render for x in (unknown, known))
    assert worst(one, other) < 1e-6


@pytest.mark.parametrize("size", [(184, 186), (185, 187)])
def test_gradients_of_a_draft_are_slopes(size):
    image, radius = noise(1, *size), torch.linspace(-3.1, 4.2, size[1]).double()
    radius, weight = radius.expand(size), noise(1, *size)
    at = [x.clone().requires_grad_() for x in (image, radius)]
    (render(*at, quality="draft").render * weight).sum().backward()
    for k, direction in enumerate((noise(1, *size), noise(*size))):
        moved = []
        for step in (1e-4, -1e-4):  # rounding: 1e-9
            scene = [image, radius]
            scene[k] = scene[k] + step * direction
            moved.append(float((render(*scene, quality="draft").render * weight).sum()))
        grad = at[k].grad
        finite = (moved[0] - moved[1]) / 2e-4
        assert float((grad * direction).sum()) == pytest.approx(finite, rel=1e-3)


def test_depth_of_photographs_is_repaired_before_it_is_halved():
    """Its edges are several px wide: in coarse pixels they might be taken for averages."""
    image, radius = scenery("cards", 300, 400, 24.0)
    around = torch.nn.functional.pad(radius[None, None], (4, 4, 4, 4), mode="replicate")
    soft = torch.nn.functional.avg_pool2d(around, 9, stride=1)[0, 0]
    draft = Renderer(Scene(image, soft), Settings(quality="draft"))
    assert draft.repair == Renderer(Scene(image, soft)).repair
    assert draft.repair.soft_edges
    hard = render(image, radius, quality="draft").render
    assert psnr(render(image, soft, quality="draft").render, hard) > 30
