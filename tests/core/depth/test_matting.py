"""Mixed pixels: taken apart where they are mixed, left alone where they are not."""

from types import SimpleNamespace

import pytest
import torch
from measures import worst
from scenes import pattern

from defocus_core.depth.matting import mixed_pixels, radii_by_color

SIZE = (32, 48)
EDGE = 20  # the column that is mixed


def unmixed(image, radius):
    """Colours and coverage of own surfaces, and what mixed pixels hold of nearer ones."""
    found = mixed_pixels(image, radius)
    color, coverage, at = image.clone(), torch.ones_like(image[:1]), found.at.unbind(1)
    color[:, *at], coverage[:, *at] = found.own[:-1], found.own[-1:]
    some = found.nearer[-2] > 0
    *colors, share, radii = found.nearer[:, some]
    layer = torch.stack([*(each * share for each in colors), share], 1)
    fringe = SimpleNamespace(at=found.at[some], layer=layer, signed_radius=radii)
    return SimpleNamespace(color=color, coverage=coverage, fringe=fringe)


def card(alpha, near_r=-6.0, far_r=3.0):
    """Red on the left before green on the right; column EDGE holds alpha of red."""
    red, green = (torch.tensor(c, dtype=torch.float64) for c in ([0.8, 0.1, 0.2], [0.1, 0.5, 0.3]))
    share = torch.zeros(SIZE[1], dtype=torch.float64)
    share[:EDGE], share[EDGE] = 1.0, alpha
    image = red[:, None, None] * share + green[:, None, None] * (1 - share)
    radius = torch.where(share >= 0.5, near_r, far_r).to(torch.float64)
    return image.expand(3, *SIZE).clone(), radius.expand(SIZE).clone()


@pytest.mark.parametrize("alpha", [0.25, 0.4, 0.5, 0.6, 0.75])
def test_a_mixed_pixel_becomes_two_surfaces(alpha):
    o = unmixed(*card(alpha))
    own = 0 if alpha >= 0.5 else -1
    assert worst(o.color[:, :, EDGE], o.color[:, :, own]) < 0.05
    if alpha >= 0.5:
        assert worst(o.coverage[:, :, EDGE], alpha) < 0.05
    else:
        assert worst(o.fringe.layer[:, -1], alpha) < 0.06
        assert worst(o.fringe.signed_radius, -6.0) < 1e-12
        assert worst(o.coverage, 1.0) < 1e-3


@pytest.mark.parametrize("alpha", [0.25, 0.4])
def test_a_third_surface_beside_takes_no_part(alpha):
    """A pixel of green, mixed with red, does not take the colour of what is between them below."""
    image, radius = card(alpha)
    green, dark = image[:, 0, -1].clone(), image[:, 0, -1] / 8
    image[:, 16:, EDGE + 1 :], radius[16:, EDGE:] = dark[:, None, None], 0.0
    image[:, 16:, EDGE] = (alpha * image[:, 0, 0] + (1 - alpha) * dark)[:, None]
    o = unmixed(image, radius)
    assert worst(o.color[:, :16, EDGE], green[:, None]) < 0.05
    assert worst(o.color[:, 16:, EDGE], dark[:, None]) < 0.05


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_what_is_beside_a_thin_wire_is_cleaned_of_it(share):
    """No pixel of the wire is off an edge, and none need be whole."""
    green, grey = (torch.tensor(c, dtype=torch.float64) for c in ([0.1, 0.5, 0.3], [0.7, 0.7, 0.7]))
    held = torch.zeros(SIZE[1], dtype=torch.float64)
    held[9:13] = torch.tensor([share, 0.8, 0.9, share])
    image = (grey[:, None] * held + green[:, None] * (1 - held))[:, None].expand(3, *SIZE).clone()
    radius = torch.where(held > 0.5, -5.0, 0.0).to(torch.float64).expand(SIZE).clone()
    o = unmixed(image, radius)
    for column in (9, 12):
        assert worst(o.color[:, :, column], green[:, None]) < 0.03
        assert worst(image[:, :, column], green[:, None]) > 0.1
    for column in (10, 11):
        given, own = (worst(x[:, :, column], grey[:, None]) for x in (image, o.color))
        assert own < given + 1e-6
    lost = (image - o.color)[:, :, [9, 12]]
    of_fringe = o.fringe.layer[:, :-1].sum(0) - green * o.fringe.layer[:, -1].sum()
    assert worst(of_fringe, lost.sum((1, 2))) < 0.02 * SIZE[0]


def test_a_steep_slope_is_no_edge():
    """As depth that was estimated has it: 0.9 px per px, over colours that change along it."""
    image = pattern(SIZE)
    radius = (0.9 * (torch.arange(SIZE[1]) - 20.0)).clamp(-3, 3).double().expand(SIZE).clone()
    o = unmixed(image, radius)
    assert torch.equal(o.color, image)
    assert not len(o.fringe.at)


def test_print_behind_a_leaf_gets_no_colours_that_are_nowhere():
    """A colour out of the range of its surface is cut off: what it held is the other surface's."""
    generator = torch.Generator().manual_seed(1)
    size, (y, x) = (60, 80), torch.meshgrid(torch.arange(60), torch.arange(80), indexing="ij")
    ink = torch.rand(20, 27, generator=generator).repeat_interleave(3, 0).repeat_interleave(3, 1)
    paper = torch.tensor([0.85, 0.8, 0.72]).double()[:, None, None]
    far = torch.where(ink[:, :80] > 0.5, 0.05, paper)
    green = torch.tensor([0.06, 0.1, 0.03]).double()[:, None, None]
    leaf = green * (1 + 0.2 * torch.rand(size, generator=generator).double())
    near = (x - 40) ** 2 + (y - 30) ** 2 < 18**2
    image, radius = torch.where(near, leaf, far), torch.where(near, -12.0, 0.0).double()
    found = unmixed(image, radius)
    assert len(found.fringe.at)
    layer = found.fringe.layer
    own, fringe = found.color.flatten(1).T, layer[:, :-1] / layer[:, -1:]
    colourful = image.amax(0) - image.amin(0)
    for colors in (own, fringe):
        assert (colors.amax(1) - colors.amin(1)).max() < colourful.max() + 0.04


def test_a_lamp_beside_a_nearer_surface_stays_whole():
    """What neither surface's colours explain is of the surface that the depth names."""
    image = torch.where(torch.arange(SIZE[1]) < 20, 0.2, 0.3).double().expand(3, *SIZE).clone()
    image[:, 10, 20] = 50.0
    radius = torch.where(torch.arange(SIZE[1]) < 20, 0.3, 30.0).double().expand(SIZE)
    o = unmixed(image, radius)
    assert float(o.color[0, 10, 20]) > 0.99 * 50
    assert float(o.fringe.layer[:, :3].sum()) < 0.01 * 50


@pytest.mark.parametrize("px", [1, 2])
def test_colours_decide_of_which_surface_a_pixel_is(px):
    """Pixels left to the other surface, on either side of an edge, go to that of their colours."""
    columns, odd = torch.arange(SIZE[1]).expand(SIZE), torch.arange(SIZE[0])[:, None] % 8 == 0
    image = torch.where(columns < 20, 0.2, 0.6).double().expand(3, *SIZE)
    exact = torch.where(columns < 20, -12.0, 0.0).double()
    for shift in (-px, px):
        given = torch.where(columns < 20 + shift * odd, -12.0, 0.0).double()
        decided = torch.ones_like(given, dtype=torch.bool)
        assert torch.equal(radii_by_color(given, image, decided), exact)
        assert radii_by_color(exact, image, decided) is exact
        assert radii_by_color(given, image, ~decided) is given
