"""Depth that is averaged at edges, like colours, is made hard again."""

import math

import pytest
import torch
from measures import inner, psnr
from renderers import repair_of
from scenes import RADII
from torch.nn.functional import avg_pool2d, interpolate

from defocus_core import DefocusLens
from defocus_core.depth.ramps import AVERAGED, without_ramps

SIZE = (144, 200)
FINE = 8
INFINITY = 12.0
SURFACES = (-18.0, -6.0, 2.0, 9.0)


def fine_radii():
    """Cards of straight and of round edges before something farther, many samples a pixel."""
    y, x = ((torch.arange(FINE * n, dtype=torch.float64) + 0.5) / FINE for n in SIZE)
    y = y[:, None]
    found = torch.full((FINE * SIZE[0], FINE * SIZE[1]), SURFACES[3], dtype=torch.float64)
    found[(x - 60) ** 2 + (y - 50) ** 2 < 32**2] = SURFACES[2]
    found[0.9 * x + 0.4 * y > 180] = SURFACES[1]
    found[0.3 * x - y < -100] = SURFACES[0]
    return found


def filtered(values, width):
    """What pixels hold that see all samples so many px around evenly."""
    values = torch.nn.functional.pad(values[None], (FINE * (width - 1) // 2,) * 4, mode="replicate")
    return avg_pool2d(values, FINE * width, FINE)[0]


def of_disparity(width=1):
    """Radii are linear in disparity."""
    return filtered(fine_radii(), width)


def of_distance(width=1):
    """Distances are 1 / (INFINITY - r) in some unit."""
    return INFINITY - 1 / filtered(1 / (INFINITY - fine_radii()), width)


def sampled():
    """What pixels hold that see the sample in their middle."""
    return fine_radii()[FINE // 2 :: FINE, FINE // 2 :: FINE].clone()


def told(radius, infinity=INFINITY):
    return repair_of(radius, infinity).antialiased


def nowhere(radius):
    """The share of pixels that are on none of the surfaces."""
    off = (radius[..., None] - radius.new_tensor(SURFACES)).abs().amin(-1)
    return float((off > 0.1).double().mean())


CASES = {"distance": of_distance, "disparity": of_disparity}


@pytest.mark.parametrize("made", CASES.values(), ids=CASES)
def test_averages_are_told(made):
    assert told(made(1))
    assert told(made(2))
    assert not told(sampled())


def made_hard(radius):
    """Radii whose edges of averages are steps."""
    slope = repair_of(radius, INFINITY).soft_edges
    return without_ramps(radius, slope, AVERAGED)


@pytest.mark.parametrize("made", CASES.values(), ids=CASES)
def test_pixels_between_surfaces_get_one_of_them(made):
    """Of which one they hold more, colours say afterwards."""
    for width in (1, 2, 3):
        given = made(width)
        assert nowhere(given) > 0.01
        assert nowhere(made_hard(given)) < 0.15 * nowhere(given), width


@pytest.mark.parametrize("kind", RADII)
def test_what_holds_no_averages_is_not_told(kind):
    for scale in (1.0, 3.0):
        assert not told(scale * RADII[kind](SIZE), scale * INFINITY)


@pytest.mark.parametrize("made", CASES.values(), ids=CASES)
def test_edges_many_pixels_wide_are_not_anti_aliased(made):
    """Networks draw such, whatever the blur: with little of it they are no soft edges either."""
    for width in (9, 13):
        given = made(width)
        for share in (0.15, 0.3, 1.0):
            assert not told(share * given, share * INFINITY)


def test_a_few_pixels_between_two_surfaces_are_things():
    """A frame of hard edges with a step here and there is as it is."""
    radius = sampled()
    radius[10:20, 10] = -10.0
    assert not told(radius)


def test_depth_of_half_the_resolution_made_larger():
    small = sampled()[None, None, ::2, ::2]
    given = interpolate(small, SIZE, mode="bilinear", align_corners=False)[0, 0]
    assert told(given)
    assert nowhere(made_hard(given)) < 0.1 * nowhere(given)


def colored(radius):
    """A picture in which each sample has the colour of its surface."""
    colors = torch.tensor([[0.9, 0.1, 0.2], [0.1, 0.6, 0.1], [0.1, 0.2, 0.9], [0.5, 0.5, 0.4]])
    number = (radius[..., None] - radius.new_tensor(SURFACES)).abs().argmin(-1)
    return colors.double()[number].movedim(-1, 0)


def test_the_lens_tells_how_far_infinity_is():
    """`render_rgbd` knows distances, and so what their averages are."""
    lens = DefocusLens(50.0, 1.8, (36.0, 25.92), (SIZE[1], SIZE[0]), dtype=torch.float64)
    for foc_dist in (1000.0, math.inf):
        lens.refocus(foc_dist)
        far = float(lens.signed_radius(torch.tensor(math.inf, dtype=torch.float64)))
        assert lens.radius_at_infinity() == pytest.approx(far)
    lens.refocus(1000.0)
    lens.d_far = -3000.0
    assert lens.radius_at_infinity() > float(lens.signed_radius(math.inf))
    lens.d_far = -math.inf
    depth = 1000 / (1 - fine_radii() / 60)
    image = avg_pool2d(colored(fine_radii())[None], FINE)
    hard, averaged = depth[FINE // 2 :: FINE, FINE // 2 :: FINE], filtered(depth, 1)
    best, found = (lens.render_rgbd(image, z[None]) for z in (hard, averaged))
    assert psnr(inner(found, 18), inner(best, 18)) > 53  # 48 of depth as it is
