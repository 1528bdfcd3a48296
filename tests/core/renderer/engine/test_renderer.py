"""A picture that is handed out in regions is the picture."""

import pytest
import torch
from renderers import renderer_of
from synthetic_scenes import scenery

from defocus_core import HiddenLayer, render

KINDS = ("render", "left", "right")


def put_together(renderer):
    (H, W), found = renderer.size, {}
    for part in renderer.tiles():
        for kind in (*KINDS, "trust"):
            pixels = getattr(part, kind)
            if pixels is not None:
                whole = found.setdefault(kind, torch.full((*pixels.shape[:-2], H, W), torch.nan))
                part.box.crop(whole).copy_(pixels)
    return found


def same(found, rendering):
    return all(torch.equal(found[kind], getattr(rendering, kind)) for kind in found)


@pytest.mark.parametrize("kind", ["most", "lights", "focus"])
def test_a_renderer_is_the_rendering(kind):
    image, radius = scenery(kind, 450, 100, 6.0)
    whole = render(image, radius, left_right=True)
    for threads in (1, 3):
        renderer = renderer_of(image, radius, left_right=True, threads=threads)
        pictures = put_together(renderer)
        assert pictures.keys() == {*KINDS, "trust"}
        assert same(pictures, whole)
        assert renderer.stats == whole.stats


def test_a_known_layer_is_handed_out_in_regions_too():
    image, radius = scenery("cards", 200, 260, 8.0)
    known = HiddenLayer(image.flip(-1), radius + 9, radius < radius.mean())
    whole = render(image, radius, hidden=known)
    assert not torch.equal(whole.render, render(image, radius).render)
    renderer = renderer_of(image, radius, hidden=known)
    assert same(put_together(renderer), whole)


@pytest.mark.parametrize("kind", ["cards", "thin"])
@pytest.mark.parametrize("quality", ["standard", "high"])
def test_a_tile_sees_all_that_spreads_to_it(kind, quality):
    """In double precision nothing but what a tile left out would tell: large radii, edges."""
    image, radius = (x.double() for x in scenery(kind, 200, 60, 24.0))
    usual, *others = (
        render(image, radius, quality=quality, left_right=True, **tile)
        for tile in ({}, {"tile": 48}, {"tile": 320})
    )
    for name in KINDS:
        for other in others:
            assert float((getattr(usual, name) - getattr(other, name)).abs().max()) < 1e-7, name


def test_the_caller_who_takes_a_region_keeps_gradients():
    """Also a caller who takes only the first region."""
    image, radius = torch.rand(3, 40, 50), torch.full((40, 50), 3.0)
    regions = renderer_of(image, radius).tiles()
    next(regions)
    assert torch.is_grad_enabled()
    regions.close()
    assert torch.is_grad_enabled()
