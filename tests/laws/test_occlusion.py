"""Nearer covers farther, never the reverse: cards before backgrounds against explicit layers."""

import math

import pytest
import torch
from measures import inner, psnr, worst
from reference import flatten
from renderers import QUALITIES
from scenes import SIZE, card_layers
from tolerances import RENDERED
from torch.nn.functional import max_pool2d
from two_cards import BORDER, plain_layers, truths

from defocus_core import render

EXACT = RENDERED[torch.float64]
# 24 lens points a diameter against areas: 1 % of the rim's pixels, times a contrast of 0.65
SAMPLING = 7e-3


def near(mask, distance):
    """Pixels within a distance of the mask, the mask included."""
    return max_pool2d(mask[None].double(), 2 * distance + 1, 1, distance)[0] > 0


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("background_r", [0.75, 3.0, 7.0, 20.0])
def test_a_card_in_focus_keeps_every_pixel_of_its_edge(background_r, quality):
    image, radius = flatten(card_layers(0.0, background_r, margin=44), SIZE)
    o = render(image, radius, quality=quality, left_right=True)
    card = radius == 0
    for picture in o.images:
        assert worst(picture[:, card], image[:, card]) < 3e-3  # texture beside it may be mixed


@pytest.mark.parametrize("card_r", [-1.0, -7.0])
def test_the_sharp_background_is_untouched_where_the_blurred_card_ends(card_r):
    image, radius = flatten(card_layers(card_r, 0.0), SIZE)
    free = ~near(radius == card_r, 9)
    assert 0.2 < free.double().mean() < 0.8
    assert worst(render(image, radius).render[:, free], image[:, free]) < EXACT


@pytest.mark.parametrize("card_r", [-3.0, -7.0])
def test_a_blurred_card_lets_the_background_through_with_its_sharpness(card_r):
    """Beside the card's edge the picture is card and sharp background by coverage alone."""
    image, radius = flatten(card_layers(card_r, 0.0), SIZE)
    shown = inner((radius == 0.0)[None], BORDER)[0]
    error = inner(render(image, radius).render - truths(card_r, 0.0, False)[0], BORDER)
    assert worst(error[:, shown], 0.0) < 0.1  # a pixel of texture may be a mixture
    assert float(error[:, shown].square().mean().sqrt()) < 0.01


@pytest.mark.parametrize(
    ("card_r", "background_r"),
    [
        *((-7.0, 0.0), (-3.0, 0.0), (-2.2, 0.0), (-1.5, 0.0), (0.0, 1.5)),
        *((-5.0, 6.0), (3.0, 8.0), (-7.5, -3.0), (-8.0, -6.0)),
    ],
)
def test_a_card_before_one_colour_is_what_the_lens_sees(card_r, background_r):
    """What the card hides is of the same colour, so nothing has to be guessed."""
    image, radius = flatten(plain_layers(card_r, background_r), SIZE)
    o = render(image, radius, left_right=True)
    expected = truths(card_r, background_r, True)
    for picture, truth in zip(o.images, expected, strict=True):
        # the halves have half the lens points, and a slice radii that keeps no first moment
        tolerance = SAMPLING if picture is o.render else 2 * SAMPLING
        # two surfaces as close as that may be one layer, whose slices add before they occlude
        tolerance *= 3 if 1 < card_r / (background_r or 1) < 1.6 else 1
        assert worst(inner(picture, BORDER), inner(truth, BORDER)) < tolerance


@pytest.mark.parametrize(
    ("card_r", "background_r", "at_least"),
    [(0.0, 7.0, 35.5), (-7.0, 0.0, 28.0), (-5.0, 6.0, 34.0), (3.0, 8.0, 39.0), (-8.0, -3.0, 33.5)],
)
def test_a_card_before_waves_is_near_what_the_lens_sees(card_r, background_r, at_least):
    """The waves behind the card are a guess, whose worth these numbers state: input 16 to 18 dB.

    Least where the background is sharp: of what the card hides then every wave counts.
    """
    image, radius = flatten(card_layers(card_r, background_r), SIZE)
    o = render(image, radius, left_right=True)
    truth, *halves = (inner(x, BORDER) for x in truths(card_r, background_r, False))
    assert psnr(inner(o.render, BORDER), truth) > at_least
    assert psnr(inner(o.render, BORDER), truth) > psnr(inner(image, BORDER), truth) + 10
    for picture, half in zip((o.left, o.right), halves, strict=True):
        assert psnr(inner(picture, BORDER), half) > at_least - 5


def test_a_light_behind_a_card_in_focus_stays_behind_it():
    """Its disc is clipped by the card, to the last bit."""
    image, radius = flatten(plain_layers(0.0, 6.0), SIZE)
    card = radius == 0
    row, column = card.nonzero().double().mean(0).round().long().tolist()
    edge = int(card[row].nonzero().max())
    image[:, row, edge + 2] = 1e3
    picture = render(image, radius).render
    assert worst(picture[:, card], image[:, card]) < 1e3 * EXACT
    assert picture[0, row, edge + 1] > 5
    assert column < edge


@pytest.mark.parametrize("quality", ["standard", "high"])
@pytest.mark.parametrize("edge", [-15.0, -40.0])
def test_a_light_in_focus_is_dimmed_by_what_is_blurred_before_it(edge, quality):
    """By the share of the lens that sees it past an edge so many px away."""
    height, width, begins = 60, 140, 70
    radius = torch.zeros(height, width, dtype=torch.float64)
    radius[:, :begins] = edge
    image = torch.where(radius < 0, 0.1, 0.2).expand(3, -1, -1).clone()
    for away in (2, 5, 8, 11):
        lit = image.clone()
        lit[:, 30, begins + away] += 300.0
        with_it, without = (render(each, radius, quality=quality).render for each in (lit, image))
        u = -(away + 0.5) / abs(edge)  # lens points before that see the near card
        hidden = (math.acos(-u) + u * math.sqrt(1 - u * u)) / math.pi
        assert float((with_it - without)[0].sum() / 300) == pytest.approx(1 - hidden, abs=0.05)
