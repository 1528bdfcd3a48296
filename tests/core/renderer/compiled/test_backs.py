"""The compiled back makes the pictures of the torch back, as far as layers allow."""

import numpy as np
import pytest
import torch
from measures import worst
from renderers import NEEDS_LOOPS, alone_of, renderer_of

from defocus_core import Aperture, DualPixel

pytestmark = pytest.mark.skipif(**NEEDS_LOOPS)
SIZE = 48


def random_scene(seed):
    """Up to four cards before a slope or a plane, radii within 9 px, and a texture."""
    g = np.random.default_rng(seed)
    radius = np.full((SIZE, SIZE), g.uniform(-2, 9), np.float32)
    radius += np.linspace(0, g.uniform(-3, 3), SIZE, dtype=np.float32)[:, None]
    for r in sorted(g.uniform(-9, 9, g.integers(0, 5)), reverse=True):
        height, width = g.integers(6, 30, 2)
        top, left = g.integers(0, SIZE - height), g.integers(0, SIZE - width)
        card = radius[top : top + height, left : left + width]
        np.minimum(card, np.float32(r), out=card)
    waves = 0.5 + 0.5 * np.sin(np.arange(SIZE) / g.uniform(1, 5))
    image = g.random((3, SIZE, SIZE)) if seed % 2 else g.random((3, 1, 1)) * waves[:, None] * waves
    return torch.from_numpy(image.astype(np.float32)), torch.from_numpy(radius)


def views(image, radius, back, **options):
    renderer = renderer_of(image, radius, left_right=True, back=back, **options)
    assert renderer.back == ("compiled" if back == "auto" else "torch")
    return renderer.picture()


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.bench)])
def test_random_scenes_are_those_of_the_torch_back(count):
    """A layer holds other radii in each; a hidden surface is read from other coarse pixels."""
    means = []
    for seed in range(count):
        scene = random_scene(seed)
        ours, theirs = views(*scene, "auto"), views(*scene, "torch")
        pairs = list(zip(ours.images, theirs.images, strict=True))
        means.append([float((a - b).abs().mean()) for a, b in pairs])
        assert max(worst(a, b) for a, b in pairs) < 0.2
        assert worst(ours.left + ours.right, 2 * ours.render) < 1e-5
    centre, left, right = np.array(means).T
    assert np.median(centre) < 0.0025
    assert max(np.median(left), np.median(right)) < 0.0035
    assert centre.max() < 0.012
    assert max(left.max(), right.max()) < 0.018


def smooth(size):
    """A picture without detail, in which layers of other radii show nothing."""
    y, x = torch.meshgrid(torch.linspace(0, 1, size), torch.linspace(0, 1, size), indexing="ij")
    red, green = (0.5 + 0.4 * torch.sin(6 * (x + 0.3 * y))), 0.5 + 0.4 * torch.cos(6 * y)
    return torch.stack([red, green, 0.4 + 0.3 * x])


def card(near, far, size, dark=1.0):
    """A card before a wall, darker than it or not."""
    inside = slice(size // 3, -(size // 3))
    image, radius = smooth(size), torch.full((size, size), far)
    image[:, inside, inside] *= dark
    radius[inside, inside] = near
    return image, radius


def slope(near, far, size):
    return smooth(size), torch.linspace(near, far, size)[:, None].expand(size, size).contiguous()


def lit(image, radius):
    image = torch.full_like(image, 0.1)
    image[:, 30, 30], image[:, 40, 52] = 50.0, 300.0
    return image, radius


FEATURES = {
    "a slope": slope(-4.0, 6.0, 72),
    "near focus": slope(-1.5, 1.5, 72),
    "behind a card in focus": card(0.0, 5.0, 72),
    "a card before focus": card(-5.0, 0.0, 72),
    "both sides of focus": card(-4.0, 4.0, 72),
    "a dark card": card(-5.0, 0.0, 72, dark=0.3),
    "two blurred surfaces": card(3.0, 9.0, 72, dark=0.3),
    "lights": lit(*slope(2.0, 7.0, 72)),
    "lights behind a card": lit(*card(-3.0, 6.0, 72)),
    "discs at half the resolution": card(0.0, 29.0, 144),
}


@pytest.mark.parametrize("feature", FEATURES)
def test_each_feature_is_that_of_the_torch_back(feature):
    ours, theirs = (views(*FEATURES[feature], back) for back in ("auto", "torch"))
    for a, b in zip(ours.images, theirs.images, strict=True):
        assert float((a - b).abs().mean()) < 1e-3
        assert worst(a, b) < 0.025
    assert float((ours.trust - theirs.trust).abs().mean()) < 2e-3


OPENINGS = {
    "blades": Aperture(blades=5, rotation=13.0),
    "curved blades": Aperture(blades=7, rotation=20.0, curvature=0.5),
    "a square": Aperture(blades=4, rotation=45.0),
    "squeezed blades": Aperture(blades=5, rotation=33.0, squeeze=0.6),
}


@pytest.mark.parametrize("opening", OPENINGS)
@pytest.mark.parametrize("feature", ["both sides of focus", "lights behind a card"])
def test_each_opening_is_that_of_the_torch_back(feature, opening):
    options = {"aperture": OPENINGS[opening]}
    ours, theirs = (views(*FEATURES[feature], back, **options) for back in ("auto", "torch"))
    for a, b in zip(ours.images, theirs.images, strict=True):
        assert float((a - b).abs().mean()) < 1e-3
        assert worst(a, b) < 0.025
    assert float((ours.trust - theirs.trust).abs().mean()) < 2e-3


def test_bands_in_threads_change_no_byte():
    image, radius = card(-6.0, 4.0, 300)
    radius[:, 250:] = 40.0
    one, two = (views(image, radius, "auto", threads=threads) for threads in (1, 2))
    assert all(torch.equal(a, b) for a, b in zip(one.images, two.images, strict=True))
    assert torch.equal(one.trust, two.trust)


def test_photodiodes_that_see_the_whole_lens_are_left_to_torch():
    model = DualPixel(model="smooth")
    renderer = renderer_of(*card(-4.0, 4.0, 72), left_right=True, dual_pixel=model)
    seen = renderer.picture()
    assert renderer.back == "torch"
    assert worst(seen.left + seen.right, 2 * seen.render) < 1e-5


def test_pictures_that_loops_render_alone_are_those_of_the_renderer():
    count = 0
    for seed in range(12):
        image, radius = random_scene(seed)
        radius = radius * (1 if seed % 2 else 5)  # wide, too
        alone = alone_of(image, radius, left_right=True)
        found = renderer_of(image, radius, left_right=True).picture()
        if alone is not None:
            count += 1
            assert max(worst(a, b) for a, b in zip(alone.images, found.images, strict=True)) < 1e-6
            assert worst(alone.trust, found.trust) < 1e-6
            assert alone.stats == found.stats
    assert count > 6


def soft(radius):
    return torch.nn.functional.avg_pool2d(radius[None, None], 3, 1, 1, count_include_pad=False)[
        0, 0
    ]


def shifted(radius):
    return torch.nn.functional.max_pool2d(-radius[None, None], 7, 1, 3).neg()[0, 0]


RISE = torch.linspace(0, 12, 144)
IN_NEED = {
    "noise": lambda radius: radius + 0.2 * torch.rand(radius.shape, generator=seeded()),
    "averages": soft,
    "wide edges": lambda radius: soft(soft(soft(radius))),
    "displaced edges": shifted,
    "levels": lambda radius: torch.round(2 * (radius + RISE + RISE[:, None])) / 2,
}


def seeded():
    return torch.Generator().manual_seed(4)


@pytest.mark.parametrize("need", IN_NEED)
def test_depth_that_needs_repair_is_not_rendered_by_loops_alone(need):
    image, radius = card(-4.0, 4.0, 144, dark=0.3)
    assert alone_of(image, radius) is not None
    radius = IN_NEED[need](radius)
    assert any(renderer_of(image, radius).repair)
    assert alone_of(image, radius) is None
