"""The scene goes on beyond the frame: its border shows no step that its middle has not."""

import math
from typing import Any

import pytest
import torch
from measures import worst
from reference import kernel
from renderers import QUALITIES, renderer_of
from tolerances import WHITE
from torch.nn.functional import pad

from defocus_core import Aperture, CatEye, DualPixel, HiddenLayer, render, render_layers

NEAR, FAR = torch.tensor([0.8, 0.5, 0.2]), torch.tensor([0.2, 0.3, 0.6])
PAIRS = [(-60.0, -30.0), (-60.0, -10.0), (-30.0, 30.0), (-12.0, 0.0), (8.0, 25.0)]
# A neighbour's step at the border, as a multiple of that in the middle of the frame.
STEP = 1.5


def half_planes(near, far):
    """A near half plane over a far one, with an upright silhouette that leaves the frame."""
    height, width = 3 * int(max(-near, far, 10)), 5 * int(max(-near, far, 10))
    is_near = (torch.arange(width) < width // 2).expand(height, width)
    return torch.where(is_near, NEAR[:, None, None], FAR[:, None, None]), torch.where(
        is_near, near, far
    )


def levels(linear):
    """Grey levels of 255, encoded as sRGB."""
    light = linear.double().clamp(0, 1)
    return 255 * torch.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light.clamp(min=1e-9) ** (1 / 2.4) - 0.055
    )


def steps(picture):
    """The greatest difference of each pixel from the next one down and across."""
    grey = levels(picture)
    down, across = (grey.diff(dim=d).abs().amax(0) for d in (1, 2))
    return torch.maximum(down[:, :-1], across[:-1])


def all_images(views):
    assert len(views.images) == 3
    return list(views.images)


def has_no_step(views, radius):
    """Whether the band at the upper and lower border is as smooth as the middle row."""
    band = math.ceil(abs(radius))
    for picture in all_images(views):
        step = steps(picture)
        middle = step[len(step) // 2 - 2 : len(step) // 2 + 2].max()
        if max(step[:band].max(), step[-band:].max()) > STEP * middle:
            return False
    return True


@pytest.mark.parametrize(
    ("near", "far", "quality"), [(*pair, quality) for pair in PAIRS for quality in QUALITIES]
)
def test_a_silhouette_that_leaves_the_frame_has_no_step(near, far, quality):
    image, radius = half_planes(near, far)
    if quality in QUALITIES[1:] and near < -30:
        image, radius = image[:, ::2, ::2], radius[::2, ::2] / 2
    views = render(image, radius, quality=quality, left_right=True)
    assert has_no_step(views, float(radius.abs().max()))
    turned = render(image.mT.contiguous(), radius.T.contiguous(), quality=quality, left_right=True)
    upright = [picture.mT for picture in turned.images]
    assert has_no_step(turned._replace(images=upright), float(radius.abs().max()))


def across_corner(width, height):
    """A card that leaves the frame by two sides: [height, width] bool."""
    return (torch.arange(height)[:, None] > height // 2) & (torch.arange(width) > width // 2)


def pole(width, height):
    """An upright pole of three px that leaves the frame above and below."""
    return ((torch.arange(width) - width // 2).abs() < 2).expand(height, width)


OPTIONS: list[dict[str, Any]] = [
    {"aperture": Aperture(obstruction=0.4)},
    {"aperture": Aperture(squeeze=2.0)},
    {"aperture": Aperture(5, rotation=17.0)},
    {"cat_eye": CatEye(1.0, 0.5)},
    {"dual_pixel": DualPixel(crosstalk=0.3)},
    {"dual_pixel": DualPixel(model="smooth")},
    {"color_offsets": (0.5, 0.0, -0.5)},
]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: "-".join(map(str, options)))
@pytest.mark.parametrize("shape", [across_corner, pole])
def test_a_card_through_any_pupil_has_no_step(shape, options):
    is_near = shape(110, 72)
    image = torch.where(is_near, NEAR[:, None, None], FAR[:, None, None])
    views = render(image, torch.where(is_near, -12.0, 5.0), left_right=True, **options)
    for picture in all_images(views):
        step = steps(picture)
        middle = step[16:-16, 16:-16].max()
        assert step.max() <= STEP * middle


def test_a_known_surface_behind_a_silhouette_goes_on_too():
    image, radius = half_planes(-20.0, 6.0)
    behind = FAR[:, None, None].expand_as(image), torch.full_like(radius, 6.0)
    hidden = HiddenLayer(*behind, radius < 0)
    views = render(image, radius, hidden=hidden, left_right=True)
    assert has_no_step(views, 20.0)
    tiled = renderer_of(image, radius, hidden=hidden).tiles()
    assert [part.box[2:] for part in tiled] == [radius.shape]


@pytest.mark.parametrize("coverage", [1.0, 0.6])
def test_a_layer_that_leaves_the_frame_has_no_step(coverage):
    image, radius = half_planes(-20.0, 6.0)
    covers = torch.stack([coverage * (radius < 0), torch.ones_like(radius)])
    colors = torch.stack(
        [NEAR[:, None, None].expand_as(image), FAR[:, None, None].expand_as(image)]
    )
    radii = torch.stack([torch.full_like(radius, -20.0), torch.full_like(radius, 6.0)])
    views = render_layers(colors * covers[:, None], radii, covers, left_right=True)
    assert has_no_step(views, 20.0)
    assert worst(views.render[-1], 1.0) < WHITE


@pytest.mark.parametrize("quality", QUALITIES[:2])
def test_the_border_is_that_of_a_larger_picture_with_the_same_edge(quality):
    """Where surfaces end on the edge as they go on, it is the same picture."""
    image, radius = half_planes(-14.0, 9.0)
    around = 32
    wider = pad(image[None], [around] * 4, mode="replicate")[0]
    farther = pad(radius[None, None], [around] * 4, mode="replicate")[0, 0]
    own, larger = (
        render(*scene, quality=quality, left_right=True, depth_repair="off")
        for scene in ((image, radius), (wider, farther))
    )
    for picture, whole in zip(own.images, larger.images, strict=True):
        inner = whole[:, around:-around, around:-around]
        assert worst(picture, inner) < 2e-3


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("r", [-9.0, 14.0])
def test_of_a_light_at_the_border_the_share_within_stays(r, quality):
    image = torch.zeros(1, 64, 72)
    image[0, 30:32, 4:6] = 100.0
    disc = kernel(r)
    reach = disc.shape[0] // 2
    within = sum(float(disc[:, reach - column :].sum()) for column in (4, 5)) / 2
    picture = render(image, torch.full((64, 72), r), quality=quality).render
    assert float(picture.sum()) / 400 == pytest.approx(within, rel=3e-3)
