"""Sharp lines in pictures: steps between neighbours where everything around is blurred."""

import torch

from defocus_core.tensors.neighbourhoods import extreme_around

# A step is sharp above so many grey levels; a surface is blurred from so many px of radius on, if
# all surfaces within so many px are.
STEP, BLURRED, AROUND = 20, 6.0, 10


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


def explained_by_depth(signed_radius):
    """Where something around is not blurred, by radii [H, W] px."""
    return extreme_around(signed_radius.abs(), AROUND, torch.minimum) < BLURRED


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
