"""A card before a background, and what the lens sees of both."""

from functools import cache

import torch
from reference import layered, left, lens_points, right, whole
from scenes import SIZE, card_layers

BORDER = 9  # what lies outside the frame is not in the picture


def plain_layers(card_r, background_r):
    """A card before one colour: what the card hides can be known."""
    card, background = card_layers(card_r, background_r)
    return [card, background._replace(color=torch.full_like(background.color, 0.3))]


@cache
def truths(card_r, background_r, plain):
    """Through the whole lens, its left and its right half."""
    layers = (plain_layers if plain else card_layers)(card_r, background_r)
    return tuple(layered(layers, lens_points(24, pupil), SIZE) for pupil in (whole, left, right))
