"""Tiny pictures with signed CoC radius for the laws: float64 image [C, H, W] and radius [H, W]."""

import torch
from reference import Layer, flatten
from torch import Tensor

Scene = tuple[Tensor, Tensor]
SIZE = (40, 56)  # H, W: not square, so that swapped axes show


def slanted(size=SIZE, near=-6.0, far=9.0):
    """Radius of a plane that recedes to the right and a little upwards."""
    H, W = size
    across = torch.linspace(0, 1, W, dtype=torch.float64)[None, :]
    upward = torch.linspace(1, 0, H, dtype=torch.float64)[:, None]
    return near + (far - near) * (0.8 * across + 0.2 * upward)


def steps(size=SIZE):
    """Radius of four upright strips in a mixed order of depth."""
    H, W = size
    values = torch.tensor([4.0, -5.0, 0.0, 8.0], dtype=torch.float64)
    return values[torch.arange(W) * 4 // W].expand(H, W).clone()


def checkerboard(size=SIZE):
    """Radius that jumps between near and far at every pixel."""
    H, W = size
    odd = (torch.arange(H)[:, None] + torch.arange(W)[None, :]) % 2
    return torch.where(odd == 1, 6.0, -4.0).to(torch.float64)


def random_radius(size=SIZE, seed=0):
    """Independent radii from -7 to 7 px."""
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(size, generator=generator, dtype=torch.float64) * 14.0 - 7.0


RADII = {"slanted": slanted, "steps": steps, "checkerboard": checkerboard, "random": random_radius}


def white(kind="slanted", size=SIZE):
    """White everywhere, at the depths named in RADII."""
    return torch.ones(3, *size, dtype=torch.float64), RADII[kind](size)


def pattern(size=SIZE, period=9.0):
    """Smooth coloured waves in [0.1, 0.9]."""
    H, W = size
    y = torch.arange(H, dtype=torch.float64)[:, None]
    x = torch.arange(W, dtype=torch.float64)[None, :]
    phases = [(1.0, 0.3), (-0.4, 1.0), (0.7, 0.7)]
    waves = [torch.sin(6.2832 / period * (a * x + b * y) + 2 * a) for a, b in phases]
    return 0.5 + 0.4 * torch.stack(waves)


def plane(r, size=SIZE):
    """Coloured waves at one radius."""
    return pattern(size), torch.full(size, r, dtype=torch.float64)


def card_layers(card_r, background_r, size=SIZE, margin=14):
    """A bright card with straight edges before waves, whole also where the card hides them."""
    h, w = size[0] + 2 * margin, size[1] + 2 * margin
    alpha = torch.zeros(h, w, dtype=torch.float64)
    alpha[h // 4 : 2 * h // 3, w // 3 : 3 * w // 5] = 1.0
    tint = torch.tensor([0.95, 0.75, 0.2], dtype=torch.float64)[:, None, None]
    background = Layer(0.6 * pattern((h, w)), torch.ones(h, w, dtype=torch.float64), background_r)
    return [Layer(tint * alpha, alpha, card_r), background]


def blurred_card(card_r=-7.0, size=SIZE):
    """A blurred card before a background in focus."""
    return flatten(card_layers(card_r, 0.0, size), size)
