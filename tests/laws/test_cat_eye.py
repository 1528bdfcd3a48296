"""Cat's eyes: clipped by the rim, symmetric, and white stays white."""

import math

import pytest
import torch
from jobs_files import lens_values

from defocus_core import Aperture, CatEye, render
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of

SIZE = (96, 160)  # H, W
CAT = CatEye(1.05, 0.7)


def scene():
    generator = torch.Generator().manual_seed(2)
    radius = torch.linspace(-8, 12, SIZE[0])[:, None].repeat(1, SIZE[1])
    radius[30:60, 50:100] = -6.0
    return torch.rand(2, *SIZE, generator=generator), radius


def test_the_cat_s_eye_is_mirror_symmetric():
    image, radius = scene()
    plain = render(image, radius, cat_eye=CAT, left_right=True)
    flipped = render(image.flip(-1), radius.flip(-1), cat_eye=CAT, left_right=True)
    assert (plain.render - flipped.render.flip(-1)).abs().max() < 2e-5
    assert (plain.left - flipped.right.flip(-1)).abs().max() < 5e-5
    upright = render(image.flip(-2), radius.flip(-2), cat_eye=CAT)
    assert (plain.render - upright.render.flip(-2)).abs().max() < 2e-5


@pytest.mark.parametrize(("aspect", "squeeze"), [(0.5, 1.0), (2.0, 1.0), (2.0, 1.5)])
def test_a_scene_is_the_same_in_pixels_of_any_aspect(aspect, squeeze):
    """Lights of 4 by 4 px, which pixels of half a width or height show as well."""
    image, radius = torch.zeros(1, *SIZE), torch.full(SIZE, 16.0)
    for y, x in ((12, 12), (40, 140), (80, 72)):
        image[:, y : y + 4, x : x + 4] = 1

    def coarse(values):  # along the axis of the longer pixels
        dim = -1 if aspect > 1 else -2
        return values.unflatten(dim, (-1, 2)).mean(dim)

    lens = lens_values(cat_eye=(1.05, 0.7 / 0.3), squeeze=squeeze, sensor_width=20.0)

    def seen(image, radius, aspect):
        size = image.shape[:-3:-1]
        aperture, longer = aperture_in_pixels(lens, aspect)
        barrel = cat_eye_of(lens, tuple(size), aspect)
        return render(image, radius * longer, aperture=aperture, cat_eye=barrel).render

    square = coarse(seen(image, radius, 1.0))
    own = seen(coarse(image), coarse(radius) / max(aspect, 1), aspect)
    assert (own - square).abs().sum() < 0.1 * square.sum()
    wrong = seen(coarse(image), coarse(radius) / max(aspect, 1), 1.0)
    assert (wrong - square).abs().sum() > 0.3 * square.sum()


@pytest.mark.parametrize("quality", ["standard", "high"])
def test_white_stays_white_and_the_pair_makes_the_centre(quality):
    image, radius = scene()
    white = render(torch.ones_like(image), radius, cat_eye=CAT, left_right=True, quality=quality)
    assert all((view - 1).abs().max() < 1e-5 for view in white.images)
    views = render(image, radius, cat_eye=CAT, left_right=True, quality=quality)
    assert ((views.left + views.right) / 2 - views.render).abs().max() < 1e-6
    assert torch.equal(views.render, render(image, radius, cat_eye=CAT, quality=quality).render)


def test_neighbouring_regions_have_no_seam():
    wide = torch.linspace(0, 1, 1100)[None, None, :].expand(1, 64, -1).contiguous()
    bar = (wide * 40 % 1 > 0.5).float() * 0.5 + 0.25
    shown = render(bar, torch.full((64, 1100), 9.0), cat_eye=CAT).render[0, 32]
    smooth = shown[100:-100].diff().diff().abs()
    reference = render(bar, torch.full((64, 1100), 9.0)).render[0, 32, 100:-100].diff().diff().abs()
    assert smooth.max() < 2.5 * reference.max()


def test_vignetting_darkens_by_the_light_that_the_rim_takes():
    image, radius = scene()
    white = torch.ones_like(image)
    shown = render(white, radius, cat_eye=CatEye(1.0, 0.8, vignetting=True)).render[0]
    assert float(shown[48, 80]) == pytest.approx(1, abs=0.01)
    d = 0.8 * math.hypot(47.5, 79.5) / math.hypot(48, 80)
    lens = 2 * math.acos(d / 2) - d / 2 * math.sqrt(4 - d * d)
    assert float(shown[0, 0]) == pytest.approx(lens / math.pi, rel=1e-3)


FRAME = (840, 1000)  # no disc at 0.8 of the field is seen from beyond its border
LENSES = {
    "round": (Aperture(), CatEye(1.0, 0.6)),
    "tight rim": (Aperture(), CatEye(0.8, 0.7)),
    "mirror": (Aperture(obstruction=0.4), CatEye(1.05, 0.5)),
    "anamorphic": (Aperture(squeeze=2.0), CatEye(1.0, 0.6)),
    "ring": (Aperture(spherical=0.7), None),
    "hexagon": (Aperture(6, 20.0), CatEye(1.0, 0.6)),
}


def sampled(name, x, y, r, around):
    """What a lens makes of a light, from lens points on a grid much finer than pixels."""
    pupil, rim = LENSES[name]
    fine, size = 16, 2 * around + 1
    u = ((torch.arange(size * fine, dtype=torch.float64) + 0.5) / fine - size / 2) / r
    v, w = u * float(pupil.squeeze), u[:, None]  # across before it is squeezed, and down
    squared = v * v + w * w
    inside = squared <= 1
    if pupil.blades:
        middle = math.cos(math.pi / 6)
        for k in range(6):
            at = math.radians(pupil.rotation + 60 * (k + 0.5))
            inside &= v * math.cos(at) - w * math.sin(at) <= middle
    shown = inside * (squared >= pupil.obstruction**2).double()
    shown = shown * (1 + pupil.spherical * (2 * squared - 1))
    if rim is not None:
        corner = math.hypot(*FRAME) / 2
        left, top = (
            rim.shift * (n / 2 - at - 0.5) / corner
            for n, at in zip(FRAME[::-1], (x, y), strict=True)
        )
        shown = shown * ((v - left) ** 2 + (w - top) ** 2 <= rim.size**2)
    counts = shown.reshape(size, fine, size, fine).mean((1, 3))
    return counts / counts.sum()


@pytest.mark.parametrize(
    ("name", "place", "r"),
    [
        *((name, 0.0, 40.0) for name in ("round", "mirror")),
        *((name, 0.8, 40.0) for name in LENSES),
        ("round", 0.8, -40.0),
    ],
)
def test_a_light_of_40_px_is_what_lens_points_make_of_it(name, place, r):
    pupil, rim = LENSES[name]
    height, width = FRAME
    x, y = (int(n / 2 * (1 + place)) for n in (width, height))
    image = torch.zeros(1, *FRAME)
    image[0, y, x] = 1e4
    shown = render(image, torch.full(FRAME, r), aperture=pupil, cat_eye=rim).render[0] / 1e4
    assert float(shown.sum()) == pytest.approx(1, abs=1e-3)
    around = 42
    shown = shown[y - around : y + around + 1, x - around : x + around + 1]
    expected = sampled(name, x, y, r, around)
    error = float(((shown - expected) ** 2).mean())
    assert 10 * math.log10(float(expected.max()) ** 2 / error) > 45
