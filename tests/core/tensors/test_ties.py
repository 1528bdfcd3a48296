"""Rounding decides nothing: not where depth is in levels, and much is as far from this as that."""

import pytest
import torch
from measures import worst
from torch.nn.functional import avg_pool2d, interpolate, max_pool2d, pad

from defocus_core import render

# What the last bits of a picture of order one may make of it.
ROUNDED = 2e-4  # rounding where the lens sees little, up to 1e-4; a tie broken otherwise is 1e-2
# Px between two levels, and levels to each side of focus: some that binary numbers hold, and some
# that they do not.
STEPS = [(0.25, 8), (0.5, 16), (1.0, 10), (1.6, 8), (2.0, 6), (3.2, 5)]


def rounded(values):
    """Values with the last bit changed, up or down at random; equal values stay equal."""
    different, number = torch.unique(values, return_inverse=True)
    ways = torch.randint(2, different.shape, generator=torch.Generator().manual_seed(0)) * 2 - 1
    return torch.nextafter(different, ways * torch.full_like(different, torch.inf))[number]


def worst_relative(difference, picture):
    """Greatest absolute value, as a share of the greatest of the picture within 4 px."""
    around = max_pool2d(picture.abs(), 9, stride=1, padding=4)
    return float((difference / around.clamp(min=1e-12)).abs().max())


def cards(seed):
    """Thirty cards over each other, some as thin as wires, in equal steps of radius."""
    generator = torch.Generator().manual_seed(seed)

    def some(below, minimum=0):
        return int(torch.randint(minimum, below, (1,), generator=generator))

    H, W = 80 + seed % 2, 104 + seed // 2 % 2
    step, levels = STEPS[seed % len(STEPS)]
    coarse = torch.rand(1, 3, H // 6, W // 6, generator=generator)
    image = interpolate(coarse, size=(H, W), mode="bilinear")[0]
    radius = torch.full((H, W), step * some(levels + 1, -levels))
    for number in range(30):
        width = some(4, 1) if number % 3 == 0 else some(60, 1)
        top, left, height = some(H), some(W), some(60, 1)
        where = (slice(top, top + height), slice(left, left + width))
        radius[where] = step * some(levels + 1, -levels)
        image[:, *where] = 0.3 * image[:, *where] + 0.7 * torch.rand(3, 1, 1, generator=generator)
    return image, radius


def averaged(seed):
    """The same with depth averaged over three by three pixels."""
    image, radius = cards(seed)
    return image, avg_pool2d(pad(radius[None], (1, 1, 1, 1), mode="replicate"), 3, 1)[0]


def in_half_precision(seed):
    """The same with surfaces that are not quite level, in half precision."""
    image, radius = cards(seed)
    uneven = 0.02 * torch.rand(radius.shape, generator=torch.Generator().manual_seed(seed))
    return image, (radius + uneven).half().float()


def terraces(seed):
    """A hilly surface in levels of 0.3 px."""
    image, radius = cards(seed)
    hills = torch.rand(1, 1, 8, 10, generator=torch.Generator().manual_seed(seed))
    wide = interpolate(hills, size=radius.shape, mode="bicubic")[0, 0]
    return image, 0.3 * (60 * wide).round() - 8


def off(image, radius, **options):
    """By how much pictures differ at most whose radii have other last bits, or more digits."""
    given = (image, radius), (image, rounded(radius)), (image.double(), radius.double())
    seen = [render(*each, left_right=True, **options) for each in given]
    one, *others = ((*views.images, views.trust) for views in seen)
    return max(worst(a, b) for other in others for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize(
    ("seed", "quality"), [*((seed, "standard") for seed in range(6)), (3, "high")]
)
@pytest.mark.usefixtures("torch_back")
def test_the_last_bits_of_levels_make_no_other_picture(seed, quality):
    assert off(*cards(seed), quality=quality) < ROUNDED


@pytest.mark.parametrize("kind", [averaged, in_half_precision, terraces])
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.usefixtures("torch_back")
def test_nor_do_those_of_depth_that_is_repaired(seed, kind):
    assert off(*kind(seed)) < ROUNDED


@pytest.mark.parametrize("kind", [cards, averaged, in_half_precision, terraces])
def test_nor_do_they_by_compiled_loops(kind):
    for seed in range(6):
        image, radius = kind(seed)
        one, other = (render(image, r, left_right=True) for r in (radius, rounded(radius)))
        for a, b in zip((*one.images, one.trust), (*other.images, other.trust), strict=True):
            assert float((a - b).abs().max()) < 2 * ROUNDED


@pytest.mark.parametrize(("seed", "quality"), [(3, "standard"), (4, "standard"), (0, "high")])
@pytest.mark.usefixtures("torch_back")
def test_what_stops_lights_does_not_hang_on_last_bits(seed, quality):
    """In front of a light, places in slices of equal steps lie in the middle between pixels."""
    image, radius = cards(seed)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(30):
        y, x = (int(torch.randint(n, (1,), generator=generator)) for n in radius.shape)
        image[:, y, x] = 300.0
    one = render(image, radius, quality=quality)
    for other in (
        render(image, rounded(radius), quality=quality),
        render(image.double(), radius.double(), quality=quality),
    ):
        # a light beside a pixel has a share of it that is rounded
        assert worst_relative(one.render - other.render, one.render) < 2e-3


def test_parts_of_the_aperture_move_only_what_they_see():
    """A part of sixteen may miss a wire near focus altogether: what it sees of it is rounding."""
    assert off(*cards(2), quality="reference") < ROUNDED
