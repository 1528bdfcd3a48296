"""Repaired radii are no worse than the given ones: fewer pixels of the wrong surface, no torn rim.

A lobed subject before a wall, with depth as networks and files of levels give it.
"""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad

from defocus_core import guided_depth, repair_depth

SIZE, FAR = (160, 224), 15.0
TWO = torch.tensor([[0.6, 0.3, 0.15], [0.15, 0.3, 0.4]])[..., None, None]


def waves(cells, seed):
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.randn(1, 1, *(side // cells + 2 for side in SIZE), generator=generator)
    return interpolate(coarse, SIZE, mode="bicubic")[0, 0]


def textures(cells, seed, channels):
    """Textures [C, H, W] of the subject and of the wall, which are of one distribution."""
    return [
        torch.stack([waves(cells, 7 * seed + 50 * side + c).sigmoid() for c in range(channels)])
        for side in (0, 1)
    ]


COLORS = {
    "two": lambda seed: [
        c * (0.7 + 0.3 * t) for c, t in zip(TWO, textures(5, seed, 1), strict=True)
    ],
    "one": lambda seed: [torch.full((3, *SIZE), 0.4)] * 2,
    "textures": lambda seed: [0.15 + 0.7 * t for t in textures(4, seed, 3)],
    "fine textures": lambda seed: [0.15 + 0.7 * t for t in textures(2, seed, 3)],
    "grey textures": lambda seed: [
        (0.15 + 0.7 * t).expand(3, -1, -1) for t in textures(5, seed, 1)
    ],
}


def subject(seed, grown=0.0, wander=0.0):
    y, x = torch.meshgrid(*(torch.arange(side) - side / 2 for side in SIZE), indexing="ij")
    lobes = 52 + 6 * torch.cos(3 * torch.atan2(y, x) + seed)
    return torch.hypot(x, 1.2 * y) + wander * waves(25, seed + 99) < lobes + grown


def mean(values, rounds=3):
    """Values [H, W] averaged over 5×5 px, some times."""
    for _ in range(rounds):
        values = avg_pool2d(pad(values[None, None], (2,) * 4, mode="replicate"), 5, 1)[0, 0]
    return values


def levels(near, soft=2, pitch=1):
    means = avg_pool2d(mean(torch.where(near, 0.0, FAR), soft)[None, None], pitch)[0, 0]
    return (means / FAR * 255).round() * FAR / 255


DAMAGED = {
    "true": lambda seed: torch.where(subject(seed), 0.0, FAR),
    "soft": lambda seed: levels(subject(seed)),
    "thin": lambda seed: levels(subject(seed, -4)),
    "fat": lambda seed: levels(subject(seed, 4)),
    "wander": lambda seed: levels(subject(seed, wander=3.0)),
    "quarter": lambda seed: levels(subject(seed, wander=2.0), 0, 4),
}


def roughness(near):
    """The pixels of a mask that averages of the surroundings decide otherwise."""
    return int(((mean(near.float(), 6) > 0.5) != near).sum())


@pytest.mark.parametrize("colors", COLORS)
@pytest.mark.parametrize("kind", DAMAGED)
@pytest.mark.parametrize("seed", [0, 1])
def test_repair_is_never_worse_than_none(kind, colors, seed):
    true, given = subject(seed), DAMAGED[kind](seed)
    image = torch.where(true, *COLORS[colors](seed))
    if kind == "quarter":
        depth = guided_depth(1 / (2 - given / FAR), image)
        found: Tensor = (2 - 1 / depth) * FAR
        given = interpolate(given[None, None], SIZE, mode="bilinear")[0, 0]
    else:
        found = repair_depth(given, image)[0]
    own, repaired = given < FAR / 2, found < FAR / 2
    outline = (mean(true.float(), 1) - true.float()).ne(0).sum() / 4
    assert ((repaired != true).sum() - (own != true).sum()) < 0.03 * outline
    assert roughness(repaired) <= 1.5 * max(roughness(own), roughness(true))
