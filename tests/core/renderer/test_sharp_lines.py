"""No blurred object leaves a sharp line of itself where depth ends within it."""

import pytest
import torch
from torch.nn.functional import avg_pool2d, pad

from defocus_core import render
from defocus_core.tensors.neighbourhoods import extreme_around

STEP = 20  # grey levels above which a step is sharp
# Px that the lines of a picture may have; px of radius of the card.
LONGEST, RADIUS = 10, -20.0


def sharp_lines(picture, explained):
    """The lines of sharp steps that nothing explains: row and column of a pixel, and length in px.

    Args:
        picture: [C, H, W] linear light.
        explained: [H, W] bool, pixels beside which a step has a reason.
    """
    sharp = _steps(picture) & ~explained
    left, lines = {(int(y), int(x)) for y, x in sharp.nonzero()}, []
    while left:
        line = [left.pop()]
        for y, x in line:
            beside = {(y + dy, x + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)} & left
            left -= beside
            line.extend(beside)
        rows, columns = zip(*line, strict=True)
        lines.append((*line[0], 1 + max(max(rows) - min(rows), max(columns) - min(columns))))
    return lines


def explained_by_truth(truth):
    """Where the picture [C, H, W] that a lens would take has a sharp step within 3 px."""
    return extreme_around(_steps(truth), 3, torch.maximum)


def _grey(light):
    """Grey levels of sRGB of linear light, 0 to 255."""
    light = light.clamp(0, 1)
    return 255 * torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _steps(picture):
    """Whether pixels [H, W] step to a neighbour."""
    grey = _grey(picture).mean(0)
    steps = torch.zeros(grey.shape, dtype=torch.bool)
    for dim in (0, 1):
        step = grey.diff(dim=dim).abs() > STEP
        steps.narrow(dim, 0, step.shape[dim]).logical_or_(step)
    return steps


def card(*, rim):
    """A dark card before a wall in focus, with a light rim of 2 px or none; and where it is."""
    g = torch.Generator().manual_seed(0)
    is_card = torch.zeros(130, 160, dtype=torch.bool)
    is_card[30:100, 40:120] = True
    grain = 1 + 0.3 * (torch.rand(1, 130, 160, generator=g) - 0.5)
    colors = ((0.25, 0.12, 0.05), (0.04, 0.06, 0.12), (0.5, 0.5, 0.55))
    wall, front, edge = (torch.tensor(color)[:, None, None] * grain for color in colors)
    within = ~extreme_around(~is_card, 2, torch.maximum) if rim else is_card
    return torch.where(within, front, torch.where(is_card, edge, wall)), is_card


def estimated(is_card, thinner):
    """Radii [H, W] px as a network draws them: thinner, and soft."""
    thin = ~extreme_around(~is_card, thinner, torch.maximum)
    around = pad(torch.where(thin, RADIUS, 0.0)[None, None], (2, 2, 2, 2), mode="replicate")
    return avg_pool2d(around, 5, 1)[0, 0]


def longest_line(is_card, image, radii, repair="auto"):
    truth = render(image, torch.where(is_card, RADIUS, 0.0), depth_repair="off").render
    picture = render(image, radii, depth_repair=repair).render
    lines = sharp_lines(picture, explained_by_truth(truth))
    return max((line[-1] for line in lines), default=0)


@pytest.mark.parametrize("thinner", [2, 3])
@pytest.mark.parametrize("rim", [False, True])
def test_a_thinned_card_leaves_no_line(rim, thinner):
    image, is_card = card(rim=rim)
    assert longest_line(is_card, image, estimated(is_card, thinner)) <= LONGEST


def test_lines_are_found_where_depth_is_not_repaired():
    image, is_card = card(rim=True)
    assert longest_line(is_card, image, estimated(is_card, 3), "off") > 0
    assert longest_line(is_card, image, torch.where(is_card, RADIUS, 0.0), "off") == 0
