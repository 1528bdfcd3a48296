"""Pictures nobody would take, drawn by hypothesis: each law of defocus holds for them too."""

import math
from typing import NamedTuple

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from measures import worst
from renderers import QUALITIES, TILE
from tolerances import WHITE

from defocus_core import Aperture, DefocusLens, render

NOISE = 1e-4  # of the local truth, in the dark beside lights a hundred million times as bright
OVERSHOOT = 1e-4  # of the brightest beyond the range of the picture
MEAN = 1e-6  # rounding of left, right and their mean

side = st.integers(1, 24)
sizes = st.one_of(
    st.tuples(side, side),
    st.tuples(st.just(1), st.integers(1, 150)),
    st.tuples(st.integers(1, 150), st.just(1)),
    st.sampled_from([(193, 12), (11, 204), (17, 31), (16, 32), (194, 195)]),  # tiles: 192 px
)
seeds = st.integers(0, 10_000)


class Shot(NamedTuple):
    """How a picture is taken."""

    quality: str
    blades: int

    def __call__(self, image, radius, **options):
        options = {"aperture": Aperture(self.blades), "left_right": True, **options}
        return render(image, radius, quality=self.quality, **options)

    def mean(self, left, right):
        """Of the halves, weighted by their areas."""
        aperture = Aperture(self.blades)
        share = aperture.fraction(aperture.parts(2)[0])
        return share * left + (1 - share) * right


shots = st.builds(Shot, st.sampled_from(QUALITIES), st.sampled_from([0, 3, 5, 6, 7]))


def noise(seed, *size):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(size, generator=generator, dtype=torch.float64)


def depths(kind, seed, size):
    """Shares of a range of depth [H, W], 0 to 1."""
    H, W = size
    if kind == "constant":
        return torch.full(size, float(noise(seed, 1)), dtype=torch.float64)
    if kind == "checkerboard":
        return ((torch.arange(H)[:, None] + torch.arange(W)) % 2).double()
    if kind == "specks":
        return (noise(seed, *size) > 0.03).double()
    if kind == "slanted":
        ramp = torch.linspace(0, 1, W).double() + torch.linspace(0, 1, H).double()[:, None]
        return ramp / 2
    return noise(seed, *size)


kinds = st.sampled_from(["constant", "checkerboard", "specks", "slanted", "random"])
spreads = st.sampled_from([0.0, 0.3, 0.9, 4.0, 15.0, 60.0, 400.0, 1e5])


@st.composite
def radii(draw, size, kinds):
    """Signed radii, from none to far more than the frame."""
    spread, seed = draw(spreads), draw(seeds)
    centre = draw(st.sampled_from([-1.0, 0.0, 0.6]))
    return spread * (2 * depths(draw(kinds), seed, size) - 1 + centre)


@st.composite
def through_a_lens(draw, size, kinds):
    """Signed radii of depths from a centimetre to a thousand kilometres, or the sky."""
    foclen = draw(st.sampled_from([4.0, 50.0, 400.0]))
    fnum = draw(st.sampled_from([0.7, 2.8, 64.0]))
    lens = DefocusLens(foclen, fnum, (36.0, 36.0 * size[0] / size[1]), size[::-1])
    foci = [math.inf, foclen * 1.00001, foclen * 1.1, foclen * 40, 1e9]
    lens.refocus(draw(st.sampled_from(foci)))
    decades = draw(st.sampled_from([(1.0, 9.0), (3.0, 4.0), (9.0, 9.0), (1.0, 1.0)]))
    share = depths(draw(kinds), draw(seeds), size)
    z = 10 ** (decades[0] + (decades[1] - decades[0]) * share)
    if draw(st.booleans()):
        z[share >= 0.9] = math.inf
    return lens.signed_radius(z.to(draw(st.sampled_from([torch.float32, torch.float64]))))


@st.composite
def scenes(draw, kinds=kinds):
    """A picture with noise and with white, and its radii."""
    size = draw(sizes)
    radius = draw(st.one_of(radii(size, kinds), through_a_lens(size, kinds)))
    # reported: far beyond a frame each slice radius costs a window of the frame
    maximum = 1e5 if max(size) <= 24 else 2.0 * max(size) if max(size) <= 40 else 64.0
    radius = radius.clamp(-maximum, maximum)
    reach = float(radius.max() - radius.min())
    if any(radius.shape[d] > 1 and float(radius.diff(dim=d).abs().max()) > 1 for d in (0, 1)):
        # reported: of a jump whose ends are rounded apart, what is hidden is continued by nothing
        unit = 2.0 ** (math.floor(math.log2(reach)) - 3)
        radius = (radius / unit).round() * unit
    image = 0.1 + 0.9 * noise(draw(seeds), 2, *size)
    image[1] = 1.0
    return image, radius


few = settings(deadline=None, derandomize=True, max_examples=20)


def three(o):
    return o.render, o.left, o.right


@few
@given(scene=scenes(), shot=shots)
def test_the_centre_is_a_mean_and_white_stays_white(scene, shot):
    image, radius = (x.float() for x in scene)
    o = shot(image, radius)
    for picture in three(o):
        assert picture.shape == image.shape
        assert bool(torch.isfinite(picture).all())
        assert worst(picture[1], 1.0) < WHITE
    centre, left, right = three(o)
    assert worst(shot.mean(left, right), centre) < MEAN
    assert centre[0].min() > image[0].min() - OVERSHOOT
    assert centre[0].max() < image[0].max() + OVERSHOOT
    assert torch.equal(centre, shot(image, radius, left_right=False).render)


@few
@given(scene=scenes(), shot=shots, dtype=st.sampled_from([torch.float16, torch.bfloat16]))
def test_half_precision_is_float32_rounded(scene, shot, dtype):
    image, radius = scene[0].to(dtype), scene[1].float()
    for picture, exact in zip(
        three(shot(image, radius)), three(shot(image.float(), radius)), strict=True
    ):
        assert picture.dtype == dtype
        assert picture.shape == image.shape
        assert torch.equal(picture, exact.to(dtype))
        assert worst(picture[1], 1.0) < WHITE


@st.composite
def lights(draw):
    """A few lights in the left part of the dark, radii, and the first column none of them reaches.

    reported: of more than one pixel in 200 as bright as that, the transforms' rounding shows.
    reported: the lights themselves may get brighter, at the border and between two depths.
    """
    size = draw(st.sampled_from([(24, 60), (1, 150), (25, 61), (60, 60), (20, 140)]))
    spread, kind, seed = draw(st.sampled_from([0.4, 3.0, 8.0])), draw(kinds), draw(seeds)
    radius = spread * (2 * depths(kind, seed, size) - draw(st.sampled_from([0.0, 1.0, 2.0])))
    image = 10.0 ** draw(st.integers(-3, 0)) * (0.5 + noise(seed + 1, 1, *size))
    few = max(1, size[0] * size[1] // 250)
    rows, columns = (noise(seed + 2, 2, few) * torch.tensor([[size[0]], [10.0]])).long()
    image[0, rows, columns] = draw(st.sampled_from([1e2, 1e4, 1e6]))
    image, radius = image.float().double(), radius.float().double()  # the truth's input is the same
    return image, radius, 10 + math.ceil(2 * spread) + 2


@few
@given(scene=lights(), shot=shots)
def test_lights_leave_no_noise_in_the_dark(scene, shot):
    *exact, start = scene
    image, radius = (x.float() for x in exact)
    o = shot(image, radius, tile=TILE)  # by torch, as the truth is
    centre, left, right = three(o)
    truth = shot(*exact).render[..., start:]
    assert float(((centre[..., start:] - truth) / truth).abs().max()) < NOISE
    assert bool(torch.isfinite(torch.stack(three(o))).all())
    assert float(centre.min()) > float(image.min()) * (1 - NOISE)
    assert float(((shot.mean(left, right) - centre) / centre).abs().max()) < MEAN
    assert torch.equal(centre, shot(image, radius, left_right=False, tile=TILE).render)
