"""Any size, dtype, channel count and radius; what is wrong is refused at the door."""

import pytest
import torch
from measures import worst
from renderers import QUALITIES
from scenes import pattern, slanted
from tolerances import WHITE

from defocus_core import DefocusLens, RandomDefocus, render

IMAGE, RADIUS = pattern().float(), slanted().float()


def spread(size, maximum):
    """Independent radii from -most to most px."""
    return maximum * (2 * torch.rand(size, generator=torch.Generator().manual_seed(2)) - 1)


@pytest.mark.parametrize("light", [-1.0, 1e30, -1e30])
@pytest.mark.parametrize("quality", QUALITIES)
def test_even_light_of_any_sign_stays_even(quality, light):
    """Wide colours have negative light, which is no highlight."""
    size = (32, 48)
    o = render(torch.full((3, *size), light), spread(size, 6.0), quality=quality, left_right=True)
    for picture in o.images:
        assert worst(picture / light, 1.0) < WHITE


@pytest.mark.parametrize("shape", [(40, 56), (1, 40, 56), (1, 1, 40, 56)])
def test_radii_of_one_picture_come_in_any_documented_shape(shape):
    one = render(IMAGE, RADIUS.reshape(shape)).render
    assert one.shape == IMAGE.shape
    batch = render(IMAGE[None], RADIUS.reshape(shape)).render
    assert batch.shape == (1, *IMAGE.shape)
    assert torch.equal(batch[0], one)
    assert torch.equal(one, render(IMAGE, RADIUS).render)


def test_a_batch_of_no_picture_has_no_views():
    image, depth = torch.zeros(0, 3, 40, 56), torch.ones(0, 40, 56)
    every = [render(image, depth, left_right=True), RandomDefocus()(image, depth, [])[0]]
    every += [render(image, depth[:, None])]
    for views in every:
        assert {tuple(view.shape) for view in views.images} == {(0, 3, 40, 56)}
        assert views.trust.shape == (0, 1, 40, 56)
    lens = DefocusLens(50.0, 2.0, device="cpu")
    lens.refocus(2000.0)
    assert lens.render_rgbd(image, depth).shape == (0, 3, 40, 56)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 40])
def test_num_layers_is_honoured(count):
    o = render(IMAGE, RADIUS, num_layers=count)
    assert o.stats["slices"] == count
    assert worst(render(torch.ones_like(IMAGE), RADIUS, num_layers=count).render, 1.0) < WHITE


@pytest.mark.parametrize(("r", "needed"), [(9.0, 19), (-9.0, 19), (0.3, 1), (3.6, 9), (3.4, 7)])
def test_psf_ks_that_does_not_fit_names_the_size_needed(r, needed):
    radius = torch.full_like(RADIUS, r)
    render(IMAGE, radius, psf_ks=needed)
    if needed > 1:
        with pytest.raises(ValueError, match=f"at least {needed} .*got {needed - 2}"):
            render(IMAGE, radius, psf_ks=needed - 2)


def test_the_lens_passes_psf_ks_and_num_layers_on():
    lens = DefocusLens(200.0, 2.0, (36.0, 36.0 * 40 / 56), (56, 40))  # -10.6 and 5.2 px below
    lens.refocus(2000.0)
    depth = torch.full((1, 1, 40, 56), 900.0)
    depth[..., 28:] = 5000.0
    fitting = lens.render_rgbd(IMAGE[None], depth, psf_ks=65)
    assert worst(fitting, lens.render_rgbd(IMAGE[None], depth).double()) < 2e-6
    assert worst(fitting, lens.render_rgbd(IMAGE[None], depth, num_layers=1).double()) > 0.01
    with pytest.raises(ValueError, match="psf_ks must be at least"):
        lens.render_rgbd(IMAGE[None], depth, psf_ks=3)


def test_progress_counts_tiles():
    calls: list[tuple[int, int]] = []
    image, radius = torch.ones(1, 150, 200), torch.zeros(150, 200)
    o = render(image, radius, progress=lambda *done_of: calls.append(done_of))
    count = o.stats["tiles"]
    assert calls == [(k + 1, count) for k in range(count)]
