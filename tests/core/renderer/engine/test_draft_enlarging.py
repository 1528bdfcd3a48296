"""A draft: rendered at half of the size, enlarged, with the detail of what is in focus."""

import pytest
import torch
from measures import inner, psnr, worst
from reference import flatten, layered, lens_points
from scenes import card_layers
from windows import Windows, put_together, same

from defocus_core import render
from defocus_core.evaluation.synthetic_scenes import scenery
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
from defocus_core.tensors import derived


def noise(*size):
    return torch.rand(size, generator=torch.Generator().manual_seed(6))


def half(x):
    return torch.nn.functional.avg_pool2d(x[None], 2)[0]


def test_far_from_focus_a_draft_is_a_picture_of_half_the_size_enlarged():
    """Its coarse pixels are those of a picture rendered in coarse pixels."""
    image = noise(3, 80, 100)
    radius = torch.full((80, 100), 6.0)
    draft = render(image, radius, quality="draft").render
    standard = render(image, radius).render
    # not at the border: a coarse pixel on the edge, which goes on, is two px wide
    assert worst(inner(half(draft), 4), inner(half(standard), 4)) < 0.03
    assert draft.shape == image.shape


@pytest.mark.parametrize("size", [(40, 56), (41, 57), (1, 30), (30, 1), (1, 1), (3, 2)])
def test_any_size_is_rendered(size):
    image, radius = noise(2, *size), torch.linspace(-2, 4, size[1]).expand(size)
    views = render(image, radius, quality="draft", left_right=True)
    assert views.left is not None
    assert views.render.shape == views.left.shape == image.shape
    assert views.trust.shape == (1, *size)
    assert views.stats["pixels"] == size[0] * size[1]
    assert bool(torch.isfinite(views.render).all())


def test_a_black_picture_stays_black():
    radius = torch.linspace(-3, 3, 50).expand(40, 50)
    assert float(render(torch.zeros(3, 40, 50), radius, quality="draft").render.abs().max()) == 0


def test_a_frame_in_focus_is_copied():
    image, radius = noise(3, 40, 50), torch.full((40, 50), 0.14)
    views = render(image, radius, quality="draft")
    assert torch.equal(views.render, image)
    assert views.stats["pixels_copied"] == 2000


def test_what_is_in_focus_keeps_its_detail_beside_what_is_not():
    image, radius = noise(3, 80, 120), torch.zeros(80, 120)
    radius[:, 60:] = 8.0
    views = render(image, radius, quality="draft", left_right=True)
    for picture in (views.render, views.left, views.right):
        assert picture is not None
        assert worst(picture[..., :50], image[..., :50]) < 1e-6


def test_a_blurred_card_hides_detail_as_far_as_it_covers_it():
    """Against rays through the lens: better than with no detail there, or with all of it."""
    layers, size = card_layers(-7.0, 0.0), (40, 56)
    image, radius = flatten(layers, size)
    truth = layered(layers, lens_points(24), size)
    views = render(image, radius, quality="draft").render
    beside = (radius == 0).expand(views.shape)
    coarse = torch.nn.functional.interpolate(half(views)[None], size, mode="bilinear")[0]
    full = (
        coarse
        + image
        - torch.nn.functional.interpolate(half(image)[None], size, mode="bilinear")[0]
    )
    error = psnr(views[beside], truth[beside])
    assert error > psnr(coarse[beside], truth[beside])
    assert error > psnr(full[beside], truth[beside])


def test_slices_asked_for_are_those_of_the_picture():
    """Whoever asks for slices or for kernels in px gets them in px."""
    image, radius = noise(3, 40, 50), torch.linspace(-6, 6, 50).expand(40, 50)
    for asked in ({"num_layers": 5}, {"psf_ks": 31}):
        draft = render(image, radius, quality="draft", **asked)
        assert draft.stats["tiles"] == render(image, radius, **asked).stats["tiles"]
        assert psnr(draft.render, render(image, radius, **asked).render) > 30
    assert render(image, radius, quality="draft", num_layers=5).stats["slices"] == 5


@pytest.mark.parametrize(("kind", "held"), [("most", True), ("cards", False)])
def test_a_renderer_of_a_draft_is_its_rendering(kind, held, monkeypatch):
    """Also where its coarse pixels are not kept, and where regions end between bands."""
    image, radius = scenery(kind, 1401, 303, 8.0)
    hidden = HiddenLayer(image.flip(-1), radius + 9, radius < radius.mean())
    behind = hidden if kind == "cards" else None
    whole = render(image, radius, quality="draft", left_right=True, hidden=behind)
    if not held:
        monkeypatch.setattr(derived, "HELD", 0)
    renderer = Renderer(
        Scene(
            Windows(image),
            Windows(radius),
            hidden=(*map(Windows, hidden),) if behind else None,
        ),
        Settings(quality="draft", left_right=True, threads=2),
    )
    assert same(put_together(renderer), whole)
    assert renderer.stats == whole.stats


@pytest.mark.parametrize("size", [(12, 14), (13, 15)])
def test_gradients_of_a_draft_are_slopes(size):
    image, radius = noise(3, *size).double(), torch.linspace(-3.1, 4.2, size[1]).double()
    radius, weight = radius.expand(size), noise(3, *size).double()
    at = [x.clone().requires_grad_() for x in (image, radius)]
    (render(*at, quality="draft").render * weight).sum().backward()
    for k, direction in enumerate((noise(3, *size).double(), noise(*size).double())):
        moved = []
        for step in (1e-4, -1e-4):  # rounding: 1e-9
            scene = [image, radius]
            scene[k] = scene[k] + step * direction
            moved.append(float((render(*scene, quality="draft").render * weight).sum()))
        grad = at[k].grad
        assert grad is not None
        finite = (moved[0] - moved[1]) / 2e-4
        assert float((grad * direction).sum()) == pytest.approx(finite, rel=1e-4)


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
