"""What edges of depth reveal: how far, which surface comes next, and how its lines go on."""

import math

import pytest
import torch
from measures import worst
from tolerances import ROUNDING

from defocus_core import HiddenLayer, render
from defocus_core.renderer.inpainting.hidden_layers import hidden_layer

SIZE = (64, 80)
SKY, SIGN, WIRE = 14.0, 0.0, -4.0
WIRES = slice(38, 40)


def street(wires=WIRES):
    """A sky, a sign before it, and upright wires before both: of one colour each."""
    radius = torch.full(SIZE, SKY, dtype=torch.float64)
    radius[8:56, 16:64] = SIGN
    radius[:, wires] = WIRE
    image = torch.zeros(3, *SIZE, dtype=torch.float64)
    for channel, r in enumerate((SKY, SIGN, WIRE)):
        image[channel] = (radius == r).to(image)
    return image, radius


@pytest.mark.parametrize("level", [0, 1])
def test_behind_a_wire_comes_what_is_beside_it(level):
    image, radius = street()
    hidden = hidden_layer(image, radius, level=level)
    step = 1 << level
    on_wire = (slice(None), slice(WIRES.start // step, WIRES.stop // step))
    of_sign, of_sky = (slice(a // step, b // step) for a, b in ((14, 50), (0, 6)))
    assert bool(hidden.mask[on_wire].all())
    assert (hidden.signed_radius[on_wire][of_sign] - SIGN).abs().max() < 1e-6
    assert (hidden.signed_radius[on_wire][of_sky] - SKY).abs().max() < 1e-6
    assert (hidden.color[1][on_wire][of_sign] - 1).abs().max() < 1e-6
    assert (hidden.color[0][on_wire][of_sky] - 1).abs().max() < 1e-6


@pytest.mark.parametrize("quality", ["standard", "high"])
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("wires", [WIRES, slice(24, 26)], ids=["amid", "aside"])
def test_a_sign_in_focus_is_not_tinted_by_the_sky_behind_a_blurred_wire(quality, known, wires):
    """What is hidden occludes, too: behind the sign goes on the sky, and is not seen there."""
    image, radius = street(wires)
    behind = street(slice(0, 0))
    hidden = HiddenLayer(*behind, torch.ones(SIZE, dtype=torch.bool)) if known else None
    picture = render(image, radius, quality=quality, hidden=hidden).render
    inside = picture[:, 26:38, wires.start - 6 : wires.stop + 6]
    assert inside[0].max() < 1e-3
    assert (inside.sum(0) - 1).abs().max() < 1e-6
    assert inside[2].max() == pytest.approx(2 * 2 / (math.pi * abs(WIRE)), rel=0.1)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize(
    ("quality", "sign"),
    [*(("standard", r) for r in (-9.0, -2.5, 4.0)), ("high", -4.0), ("high", 2.5)],
)
def test_nor_is_a_sign_that_is_much_less_blurred_than_the_sky(quality, known, sign):
    """Whatever the colour of the sky, where the lens sees nothing but wires and the sign."""
    size, wire, sky = (120, 160), -20.0, 30.0
    y, x = torch.meshgrid(*map(torch.arange, size), indexing="ij")
    on_sign, on_wire = (abs(y - 60) < 40) & (abs(x - 80) < 60), (x % 40) < 6
    behind = torch.where(on_sign, sign, sky).double()
    radius = torch.where(on_wire, wire, behind)
    within = (abs(y - 60) < 38 - abs(sign)) & (abs(x - 80) < 58 - abs(sign))
    everywhere = torch.ones(size, dtype=torch.bool)
    seen = []
    for light in (1.0, 0.2):
        far = torch.where(on_sign, 0.2, light).double().expand(3, *size)
        image = torch.where(on_wire, 0.05, far)
        hidden = HiddenLayer(far, behind, everywhere) if known else None
        seen.append(render(image, radius, quality=quality, hidden=hidden).render)
    assert (seen[0] - seen[1])[:, within].abs().max() < 2e-3


def crossing(wall=0.0, wire=-8.0):
    """A wall, a level wire before it, and an upright one before both: of one colour each."""
    radius = torch.full(SIZE, wall, dtype=torch.float64)
    radius[30:36] = wire
    radius[:, 38:41] = -22.0
    image = torch.stack([(radius == r).to(radius) for r in (wall, wire, -22.0)])
    return image, radius


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(("wall", "channel"), [(0.0, 0), (12.0, 1)])
def test_behind_a_crossing_goes_on_what_is_sharper(wall, channel, level):
    image, radius = crossing(wall)
    layer = hidden_layer(image, radius, level=level)
    step, sharper = 1 << level, min(wall, -8.0, key=abs)
    rows, columns = slice(32 // step, 34 // step), slice(-(-38 // step), 41 // step)
    assert bool(layer.mask[rows, columns].all())
    assert (layer.signed_radius[rows, columns] - sharper).abs().max() < 2
    assert (layer.color[channel][rows, columns] - 1).abs().max() < 0.25


# In high, pixels of the upright wire beside the crossing take a quarter of the level one.
@pytest.mark.parametrize(("quality", "step"), [("standard", 0.15), ("high", 0.35)])
def test_a_crossing_out_of_focus_leaves_no_hole_in_a_wall_in_focus(quality, step):
    image, radius = crossing()
    wall = render(image, radius, quality=quality).render[0, 20:46, 28:52]
    through = (1 - 2 * 3 / (math.pi * 22)) * (1 - 2 * 6 / (math.pi * 8))  # what both let pass
    assert wall[13, 11] == pytest.approx(through, abs=0.1)
    assert max(float(wall.diff(dim=dim).abs().max()) for dim in (0, 1)) < step


def test_a_surface_that_rises_towards_an_edge_is_not_behind_itself():
    """The top of a box joins its front: behind both is the wall, beyond the edge."""
    wall, top = 24, 11
    y = torch.arange(64, dtype=torch.float64)[:, None].expand(64, 56)
    box = (-23 + 0.9 * (wall + top - y)).clamp(min=-23)
    found = hidden_layer((y >= wall).to(y)[None], torch.where(y < wall, 20.0, box))
    close = found.mask & (y < wall + top + 12)
    assert close[wall + top :].any()
    assert worst(found.color[0, close], 0.0) < ROUNDING[torch.float64]
    assert worst(found.signed_radius[close], 20.0) < ROUNDING[torch.float64]


@pytest.mark.parametrize("edge", range(16, 24))
def test_beside_an_edge_hidden_content_is_as_what_is_next_to_it(edge):
    """Wherever in the frame it is: coarse pixels of a coarser resolution do not show."""
    x = torch.arange(56, dtype=torch.float64).expand(40, 56)
    image = ((x >= edge - 2) & (x < edge)).to(x)
    found = hidden_layer(image[None], torch.where(x < edge, 6.0, -6.0).to(x))
    assert float(found.color[0, :, edge].min()) > 0.7


@pytest.mark.parametrize("degrees", [35.0, 60.0, 90.0, 120.0])
def test_stripes_go_on_behind_a_bar(degrees):
    """Smooth ones, at an angle from upright; coherence transport continues them."""
    y, x = torch.arange(96).double()[:, None], torch.arange(112).double()
    turned = x * math.cos(math.radians(degrees)) + y * math.sin(math.radians(degrees))
    wave = 0.5 + 0.3 * torch.sin(2 * math.pi * turned / 14)
    background = torch.stack([wave, 1 - wave])
    image, radius = background.clone(), torch.full_like(wave, 4.0)
    image[..., 50:60], radius[:, 50:60] = 0.9, -7.0
    found = hidden_layer(image, radius)
    mask = found.mask.clone()
    mask[:24], mask[-24:] = False, False  # stripes that leave the frame have one end
    assert mask.any()
    off = (found.color - background)[:, mask].abs()
    assert float(off.mean()) < 0.04  # of an amplitude of 0.3
    assert float(off.max()) < 0.2


@pytest.mark.parametrize(("far", "near"), [(6.0, -6.0), (10.0, 0.0), (0.0, -16.0)])
def test_what_is_hidden_is_continued_as_far_as_the_lens_sees_past_an_edge(far, near):
    """In any direction of a cone, which falls by the square root of 1/2 along an axis."""
    x = torch.arange(96, dtype=torch.float64).expand(64, 96)
    hidden = hidden_layer((x < 40).double()[None], torch.where(x < 40, far, near).double())
    assert int(hidden.mask[32].sum()) == pytest.approx((far - near) * math.sqrt(2), abs=2)
