"""A picture that is moved by whole pixels is rendered as it was, and moved."""

import pytest
import torch
from measures import worst
from torch.nn.functional import avg_pool2d, pad

from defocus_core import render, repair_depth

SIZE, AROUND = (64, 72), 24
MOVED = [(1, 0), (0, 1), (3, 5), (11, 6)]
FINE = 3


def cards(seed):
    """Textured cards before a wall, a few samples a pixel."""
    generator = torch.Generator().manual_seed(seed)

    def drawn(*size):
        return torch.rand(*size, generator=generator)

    size = (FINE * SIZE[0], FINE * SIZE[1])
    y, x = torch.meshgrid(*(torch.arange(n) / FINE for n in size), indexing="ij")
    image, radius = 0.3 + 0.2 * drawn(3, *size), torch.full(size, 6.0)
    for near in (3.0, 0.0, -5.0):
        middle = drawn(2) * 30 + 17
        card = torch.hypot(y - middle[0], x - middle[1]) < 12
        card |= (y - 0.4 * x - middle[1] + 20).abs() < 4
        radius[card] = near + 0.02 * x[card]
        image[:, card] = (drawn(3, 1, 1) * (0.5 + 0.5 * drawn(1, *size)))[:, card]
    return image, radius


def middles(values):
    return values[..., FINE // 2 :: FINE, FINE // 2 :: FINE]


def means(values, width=1):
    wide = pad(values[None], [FINE * (width // 2)] * 4, mode="replicate")
    return avg_pool2d(wide, FINE * width, FINE)[0]


def damaged(kind, seed):
    """A picture, and its radii as files and networks give them."""
    image, radius = cards(seed)
    noise = 0.15 * torch.randn(SIZE, generator=torch.Generator().manual_seed(seed))
    radii = {
        "hard": lambda: middles(radius),
        "antialiased": lambda: means(radius[None])[0],
        "soft": lambda: means(radius[None], 5)[0],
        "noisy": lambda: middles(radius) + noise,
        "levels": lambda: (middles(radius) * 8).round() / 8,
    }
    return means(image), radii[kind]()


def placed(image, radius, moved):
    """The picture in the middle of an even wall, moved."""
    down, across = moved
    around = (AROUND + across, AROUND - across, AROUND + down, AROUND - down)
    inner = torch.ones(SIZE)
    inner[:8], inner[-8:], inner[:, :8], inner[:, -8:] = 0, 0, 0, 0
    image, radius = torch.where(inner > 0, image, 0.3), torch.where(inner > 0, radius, 6.0)
    return pad(image, around, value=0.3), pad(radius, around, value=6.0)


def part(values, moved):
    down, across = moved
    return values[
        ..., AROUND + down : AROUND + down + SIZE[0], AROUND + across : AROUND + across + SIZE[1]
    ]


def difference(kind, seed, moved, **options):
    """The greatest change by a move, of the maximum, where all was seen."""
    scene = damaged(kind, seed)

    def at(to):
        return render(*placed(*scene, to), **options)

    before, after = at((0, 0)), at(moved)
    both = torch.minimum(part(before.trust, (0, 0)), part(after.trust, moved)) > 1 - 1e-6
    assert both.float().mean() > 0.05
    change = (part(before.render, (0, 0)) - part(after.render, moved)) * both
    return worst(change, 0.0) / float(before.render.max())


@pytest.mark.parametrize("kind", ["hard", "antialiased", "soft", "noisy", "levels"])
def test_repair_moves_with_the_picture(kind):
    """Its decisions once hung on every sixteenth row, wherever it lay."""
    for seed in range(2):
        scene = damaged(kind, seed)
        radii, _ = repair_depth(*reversed(placed(*scene, (0, 0))))
        for to in MOVED:
            moved, _ = repair_depth(*reversed(placed(*scene, to)))
            assert torch.equal(part(moved, to), part(radii, (0, 0)))


@pytest.mark.parametrize("kind", ["hard", "antialiased", "soft", "noisy", "levels"])
def test_repair_of_a_mirrored_or_turned_picture_is_mirrored_or_turned(kind):
    image, radius = damaged(kind, 0)
    found, _ = repair_depth(radius, image)
    for dims in ((-1,), (-2,)):
        assert worst(repair_depth(radius.flip(dims), image.flip(dims))[0].flip(dims), found) < 1e-5
    turned, _ = repair_depth(radius.T.contiguous(), image.mT.contiguous())
    assert worst(turned.T, found) < 1e-5


@pytest.mark.parametrize("kind", ["antialiased", "noisy", "hard"])
def test_a_picture_that_is_moved_is_rendered_alike(kind):
    for to in MOVED[1:3]:
        assert difference(kind, 0, to) < 2e-3


def test_trust_of_colors_apart_is_the_least_of_all():
    """It once was that of green, while red showed what was invented."""
    assert difference("hard", 1, (3, 5), color_offsets=[-0.8, 0.0, 0.8]) < 2e-3
