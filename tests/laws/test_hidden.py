"""Known hidden surfaces are used where they are known, and trust says where nothing was."""

import pytest
import torch
from measures import inner, psnr, worst
from reference import Layer, flatten, layered, lens_points
from renderers import QUALITIES
from scenes import SIZE, card_layers, pattern, slanted
from two_cards import BORDER, truths

from defocus_core import HiddenLayer, render, render_layers


def behind(card_r, background_r):
    """All of the background of a card, as if the card were not there."""
    color, radius = flatten(card_layers(card_r, background_r)[1:], SIZE)
    return HiddenLayer(color, radius, torch.ones(SIZE, dtype=torch.bool))


def test_a_complete_second_layer_is_as_exact_as_layers():
    """The scene that layers hold, however it is given: a card out of focus over a sharp wall."""
    image, radius = flatten(card_layers(-7.6, 0.0), SIZE)
    hidden = behind(-7.6, 0.0)
    known = render(image, radius, hidden=hidden).render
    colors, radii = torch.stack([image, hidden.color]), torch.stack([radius, hidden.signed_radius])
    assert worst(known, render_layers(colors, radii, torch.ones_like(radii)).render[:-1]) < 1e-6
    error = inner(known, BORDER) - inner(
        layered(card_layers(-7.6, 0.0), lens_points(24), SIZE), BORDER
    )
    assert float(error.abs().max()) < 0.026
    assert float(error.square().mean().sqrt()) < 0.0017


@pytest.mark.parametrize(("card_r", "background_r", "minimum"), [(-5.0, 6.0, 38), (-9.0, 3.0, 31)])
def test_beside_a_near_card_shows_what_it_hides_before_what_lies_beyond_focus(
    card_r, background_r, minimum
):
    # the half of the lens that sees past the card looks behind it; 35.1 and 28.9 dB if all that is
    # visible beyond focus comes first
    image, radius = flatten(card_layers(card_r, background_r), SIZE)
    truth = inner(truths(card_r, background_r, False)[0], BORDER)
    known = render(image, radius, hidden=behind(card_r, background_r)).render
    assert psnr(inner(known, BORDER), truth) > minimum


def test_behind_what_is_known_the_farthest_is_invented_where_the_lens_sees_past_that_too():
    card, background = card_layers(-9.0, 3.0)
    strip = torch.zeros_like(card.alpha)  # a wire, upright behind the card and nowhere else
    strip[:, 40:43] = card.alpha[:, 40:43]
    tint = torch.tensor([0.1, 0.2, 0.9], dtype=torch.float64)[:, None, None]
    wire = Layer(tint * strip, strip, -6.0)
    image, radius = flatten([card, background], SIZE)
    truth = inner(layered([card, wire, background], lens_points(24), SIZE), BORDER)
    color, behind_it = flatten([wire, background], SIZE)
    hidden = HiddenLayer(color, behind_it, torch.ones(SIZE, dtype=torch.bool))
    high, reference = (
        psnr(inner(render(image, radius, quality=q, hidden=hidden).render, BORDER), truth)
        for q in ("high", "reference")
    )
    assert reference > high + 2 > 40


@pytest.mark.parametrize("kind", ["slanted", "level", "focused"])
def test_all_of_a_smooth_surface_is_trusted(kind):
    level = torch.full(SIZE, 6.0).double()
    radius = {"slanted": slanted(SIZE), "level": level, "focused": 0 * level}[kind]
    trust = render(pattern(SIZE), radius).trust
    assert trust.shape == (1, *SIZE)
    assert worst(inner(trust, BORDER), 1.0) < 0.01


def test_trust_falls_where_the_lens_sees_past_an_edge_and_beyond_the_frame():
    image, radius = flatten(card_layers(-7.0, 3.0), SIZE)
    trust = render(image, radius).trust[0]
    assert float(inner(trust[None], BORDER).min()) < 0.8
    assert float(trust[0, 0]) < 0.5  # a corner sees a quarter of the frame
    known = render(image, radius, hidden=behind(-7.0, 3.0)).trust
    assert worst(inner(known, BORDER), 1.0) < 0.02


def test_what_is_known_behind_a_picture_of_great_range_keeps_the_dark_dark():
    """Such a picture is computed in float64, and what lies behind it too."""
    image, radius = flatten(card_layers(-5.0, 0.0), SIZE)
    hidden = behind(-5.0, 0.0)
    image[:, :3, :6] = 1e6
    hidden.color[:, :3, :6] = 1e6
    exact = render(image, radius, hidden=hidden).render[:, 12:, 14:]
    single = HiddenLayer(hidden.color.float(), hidden.signed_radius.float(), hidden.mask)
    seen = render(image.float(), radius.float(), hidden=single).render
    assert seen.dtype == torch.float32
    assert worst(seen[:, 12:, 14:] / exact, 1.0) < 1e-4


@pytest.mark.parametrize("quality", QUALITIES)
def test_where_hidden_surfaces_meet_nothing_is_darker_or_brighter_than_they_are(quality):
    """A bright wall in focus beside a dark one that is not, both behind a dark card."""
    x = torch.arange(112, dtype=torch.float64).expand(96, -1)
    y = torch.arange(96, dtype=torch.float64)[:, None].expand(-1, 112)
    color, radius = torch.where(x < y + 8, 0.9, 0.05), torch.where(x < y + 8, 0.0, -8.0)
    card = ((x - 56).abs() < 14) & ((y - 48).abs() < 30)
    color, radius = torch.where(card, 0.05, color), torch.where(card, -16.0, radius)
    found = render(color[None].to(x), radius.to(x), quality=quality).render
    few = 1e-3
    assert float(found.min()) > 0.05 - few
    assert float(found.max()) < 0.9 + few
