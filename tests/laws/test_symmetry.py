"""What must not matter: which way is up, batches, tiles, threads, and what is far away."""

import pytest
import torch
from measures import inner, worst
from renderers import QUALITIES
from scenes import RADII, blurred_card, pattern
from tolerances import RENDERED, ROUNDING

from defocus_core import render
from defocus_core.renderer.engine import plan
from defocus_core.tensors import box as tiling

EXACT = RENDERED[torch.float64]
SIZES = [(40, 57), (7, 150), (65, 200)]  # even and odd, thin, more than one tile


def noise(size, dtype=torch.float64):
    generator = torch.Generator().manual_seed(1)
    return torch.rand(3, *size, generator=generator, dtype=torch.float64).to(dtype)


def pair(image, radius):
    o = render(image, radius, left_right=True)
    return o.render, o.left, o.right


@pytest.mark.parametrize("kind", RADII)
@pytest.mark.parametrize("size", SIZES)
def test_flips_change_nothing_and_a_mirror_swaps_left_and_right(size, kind):
    image, radius = noise(size), RADII[kind](size)
    centre, left, right = pair(image, radius)
    mirrored = [x.flip(-1) for x in pair(image.flip(-1), radius.flip(-1))]
    upset = [x.flip(-2) for x in pair(image.flip(-2), radius.flip(-2))]
    for one, other in zip(mirrored, (centre, right, left), strict=True):
        assert worst(one, other) < EXACT
    for one, other in zip(upset, (centre, left, right), strict=True):
        assert worst(one, other) < EXACT


def turned(image, radius, quality):
    """The centre of the turned scene, turned back."""
    picture = render(image.rot90(1, (-2, -1)), radius.rot90(), quality=quality).render
    return picture.rot90(-1, (-2, -1))


@pytest.mark.parametrize("kind", RADII)
@pytest.mark.parametrize(
    ("size", "quality"), [*(((41, 57), quality) for quality in QUALITIES), ((65, 200), "standard")]
)
def test_a_quarter_turn_changes_nothing(size, kind, quality):
    """Of the centre: left and right are an upright pair."""
    image, radius = noise(size), RADII[kind](size)
    difference = render(image, radius, quality=quality).render - turned(image, radius, quality)
    assert worst(difference, 0.0) < EXACT


@pytest.mark.parametrize("channels", [1, 4, 7])
def test_channels_do_not_know_of_each_other(channels):
    """But for mixed pixels, which all channels together take apart: there are none in a slope."""
    image, radius = noise((40, 56)).repeat(3, 1, 1)[:channels], RADII["slanted"]()
    alone = torch.cat([render(one[None], radius).render for one in image])
    assert worst(render(image, radius).render, alone) < EXACT


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # of either back
@pytest.mark.parametrize("kind", RADII)
def test_threads_and_what_else_is_rendered_change_no_byte(kind, dtype):
    size = (80, 200)
    image, radius = noise(size, dtype), RADII[kind](size).to(dtype)

    def with_threads(count):
        return render(image, radius, threads=count, left_right=True)

    one, two = with_threads(1), with_threads(2)
    assert torch.equal(one.render, two.render)
    assert torch.equal(one.left, two.left)
    assert torch.equal(one.render, render(image, radius).render)
    assert one.stats == two.stats


@pytest.mark.usefixtures("torch_back")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", RADII)
def test_tiles_leave_no_seam(kind, dtype):
    size = (90, 140)
    image, radius = noise(size, dtype), RADII[kind](size).to(dtype)
    whole = render(image, radius)
    for side in (32, 64):
        tiled = render(image, radius, tile=side)
        assert tiled.stats["tiles"] > whole.stats["tiles"]
        seam = tiled.render - whole.render
        assert worst(inner(seam, 10), 0.0) < 2 * ROUNDING[dtype]
        # in the corners a half sees a tenth of itself, by which rounding is divided too
        assert worst(seam, 0.0) < RENDERED[dtype]


@pytest.mark.parametrize("size", [(101, 197)])
@pytest.mark.parametrize("kind", [*RADII, "lights"])
def test_regions_leave_no_seam(kind, size, monkeypatch):
    """What is decided for a region is what the whole frame decides."""
    image, radius = noise(size), RADII["steps" if kind == "lights" else kind](size)
    if kind == "lights":
        image[:, 50:55, ::40] = 50.0
    whole = render(image, radius, left_right=True, tile=32)
    small = tiling.grid_over(*size, side=32)._replace(region=64)
    monkeypatch.setattr(plan, "grid_over", lambda *size: small)
    monkeypatch.setattr(tiling, "MARGIN", 1e9)
    assert sum(map(len, tiling.regions(small, 0))) > 4
    cut = render(image, radius, left_right=True)
    assert worst(cut.render, whole.render) < EXACT * float(image.max())
    assert worst(cut.left, whole.left) < EXACT * float(image.max())
    assert worst(cut.trust, whole.trust) < EXACT


@pytest.mark.parametrize("r", [25.0, -25.0, 9.0, -8.0])
def test_what_is_far_away_does_not_matter(r):
    """The slice radii stands where it stands: no pixel beyond reach moves it."""
    size, card = (60, 240), blurred_card(-5.0, (60, 80))
    image, radius = pattern(size), torch.zeros(size, dtype=torch.float64)
    image[..., :80], radius[:, :80] = card
    before = render(image, radius).render
    image[:, 30, -3], radius[30, -3] = 1.0, r
    # but the brightest pixel, which bounds what detail overshoots
    assert worst(render(image, radius).render[..., :110], before[..., :110]) < 1e-4
