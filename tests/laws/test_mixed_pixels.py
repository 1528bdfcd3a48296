"""A mixed pixel holds two surfaces, whichever of them its depth names."""

import pytest
import torch
from torch.nn.functional import avg_pool2d, max_pool2d, pad

from defocus_core import HiddenLayer, render

SIZE, FINE, MARGIN = (72, 96), 6, 24
COLORS = {"dark on grey": (0.02, 0.5), "bright on dark": (0.9, 0.2), "light": (20.0, 0.2)}
RADII = [(-9.0, 0.0), (0.0, 9.0), (-6.0, 6.0)]


Y, X = (((torch.arange(FINE * n) + 0.5) / FINE).double() for n in SIZE)
FROM_MIDDLE = torch.hypot(X - 47.3, Y[:, None] - 36.7)


def disc():
    """Samples of a disc that one row of pixels cuts by any share, many a pixel."""
    return (FROM_MIDDLE < 21.4).double()


def blurred(samples, radius):
    """The share of the lens that sees the samples, for each pixel: exact to the samples."""
    by = round(abs(radius) * FINE)
    if by:
        offset = torch.arange(-by - FINE, by + FINE + 1, dtype=torch.float64)
        kernel = (offset.square() + offset.square()[:, None] <= (abs(radius) * FINE) ** 2).double()
        size = [n + len(kernel) - 1 for n in samples.shape]
        spectra = (torch.fft.rfft2(each, size) for each in (samples, kernel / kernel.sum()))
        whole = torch.fft.irfft2(next(spectra) * next(spectra), size)
        half = len(kernel) // 2
        samples = whole[half : half + samples.shape[0], half : half + samples.shape[1]]
    return avg_pool2d(samples[None], FINE)[0]


def named(kind, coverage, near, far):
    """Radii of pixels of a coverage, as files of a kind name their depth."""
    wide = {"fat": 2, "thin": -2}.get(kind, 0)
    is_near = coverage >= {"any": 1e-3, "full": 0.999}.get(kind, 0.5)
    if wide:
        own = is_near.double() if wide > 0 else 1 - is_near.double()
        grown = max_pool2d(own[None], 5, 1, 2)[0]
        is_near = (grown if wide > 0 else 1 - grown) > 0.5
    if kind == "mean":
        return coverage * near + (1 - coverage) * far
    radius = torch.where(is_near, near, far).to(coverage)
    if kind == "soft":
        weight = torch.exp(torch.arange(-8, 9, dtype=torch.float64).square() / -8)
        weight = weight / weight.sum()
        for dim in (0, 1):
            lines = pad(radius.movedim(dim, -1)[None], (8, 8), mode="replicate")[0]
            radius = (lines.unfold(-1, 17, 1) * weight).sum(-1).movedim(-1, dim)
        step = abs(near - far) / 200
        radius = (radius / step).round() * step
    return radius


@pytest.mark.parametrize("radii", RADII)
@pytest.mark.parametrize("kind", ["centre", "any", "full", "mean", "fat", "thin", "soft"])
def test_the_picture_is_that_of_both_surfaces(kind, radii):
    samples, (near, far) = disc(), radii
    coverage = blurred(samples, 0)
    radius = named(kind, coverage, near, far)
    for name, (front, back) in COLORS.items():
        color = coverage * front + (1 - coverage) * back
        seen = render(color.expand(3, *SIZE), radius, infinity=100.0).render[0]
        share = blurred(samples, near)
        off = (seen - share * front - (1 - share) * back).abs() / abs(front - back)
        assert float(off.amax()) < 0.1, name
        assert float(off.square().mean().sqrt()) < 0.015, name


@pytest.mark.parametrize("radii", RADII[:2])
@pytest.mark.parametrize("kind", ["centre", "any", "full", "mean", "soft"])
def test_a_silhouette_before_a_wall_that_is_known_is_as_smooth(kind, radii):
    """And so it is where the wall has colours of its own: each pixel's share of it is blurred."""
    (near, far), coverage = radii, blurred(disc(), 0)
    share, radius = blurred(disc(), near), named(kind, coverage, near, far)
    x, known = torch.arange(SIZE[1]).double(), torch.ones(SIZE, dtype=torch.bool)
    # in focus, a pixel whose depth names the disc keeps all of its light
    for front, contrast, most, rms in ((0.02, 0.0, 0.01, 1.3e-3), (0.9, 0.3, 0.5, 0.016)):
        wall = (0.4 + contrast * (x / 3).sin()).expand(3, *SIZE)
        hidden = HiddenLayer(wall, torch.full_like(radius, far), known)
        color = coverage * front + (1 - coverage) * wall
        seen = render(color, radius, infinity=100.0, hidden=hidden).render
        behind = render(wall, torch.full_like(radius, far)).render
        off = ((seen - share * front - (1 - share) * behind) / (front - 0.4)).abs()
        assert float(off.amax()) < most, contrast
        assert float(off.square().mean().sqrt()) < rms, contrast


def half_plane():
    """Samples left of a line at 17 degrees."""
    return (X - 47.3 + 0.3057 * (Y[:, None] - 36.7) < 0).double()


def crossings(shown, half):
    """[n] the place in each row where pixels pass a value; nan if they do not pass it once."""
    left, right = shown[MARGIN:-MARGIN, :-1] - half, shown[MARGIN:-MARGIN, 1:] - half
    passes = left * right < 0
    place = torch.arange(left.shape[1]) + left / torch.where(passes, left - right, 1.0)
    return torch.where(passes.sum(1) == 1, torch.where(passes, place, 0.0).sum(1), torch.nan)


@pytest.mark.parametrize("shape", [disc, half_plane])
@pytest.mark.parametrize("radii", [*RADII, (0.0, 15.0), (-15.0, 0.0)])
def test_silhouettes_of_soft_depth_are_smooth(radii, shape):
    """The half-way point of the rendered edge is that of the true one."""
    samples = shape()
    coverage = blurred(samples, 0)
    radius = named("soft", coverage, *radii)
    for front, back in ((0.02, 0.5), (0.9, 0.2)):
        color = coverage * front + (1 - coverage) * back
        seen = render(color.expand(3, *SIZE), radius, infinity=100.0).render[0]
        share = blurred(samples, radii[0])
        true = share * front + (1 - share) * back
        columns = slice(0, 48) if shape is disc else slice(None)
        half = (front + back) / 2
        strays = crossings(seen[:, columns], half) - crossings(true[:, columns], half)
        strays = strays[strays.isfinite()]
        assert len(strays) > 10
        assert float(strays.square().mean().sqrt()) < 0.5
        assert float(strays.abs().amax()) < 1.5


@pytest.mark.parametrize("light", [5.0, 50.0, 5e4])
def test_a_light_in_focus_adds_to_the_plane_behind_what_is_the_planes(light):
    samples = disc()
    coverage = blurred(samples, 0)
    color = (coverage * light + (1 - coverage) * 0.2).expand(3, *SIZE)
    for kind in ("centre", "any", "full"):
        seen = render(color, named(kind, coverage, 0.0, 12.0)).render[0]
        outside = coverage < 1e-3
        assert float(seen[outside].amax()) < 0.2 * 1.03 + 1e-5 * light, kind


def ring():
    """Samples of a ring 12 px wide."""
    return ((FROM_MIDDLE - 21.4).abs() < 6.2).double()


def strands():
    """Samples of a half of the frame with strands of 1.5 px, 8 px long, at its edge."""
    strand = (Y[:, None] % 6 < 1.5) & (X < 50)
    return (strand | (X < 42)).double()


def psnr(seen, truth, coverage, reach, contrast):
    """Against the contrast, of pixels within reach of an edge, far from the border of the frame."""
    side = 2 * round(reach) + 7
    edge = ((coverage > 1e-3) & (coverage < 0.999)).double()
    near = max_pool2d(edge[None], side, 1, side // 2)[0] > 0
    near[:12] = near[-12:] = False
    error = ((seen - truth) / contrast).square()[near]
    return float(-10 * (error.mean() + 1e-9).log10())


@pytest.mark.parametrize(
    ("kind", "shape"), [("soft", disc), ("fat", ring), ("thin", disc), ("thin", ring)]
)
def test_a_matte_is_the_coverage_of_the_silhouette(kind, shape):
    samples = shape()
    coverage = blurred(samples, 0)
    for near, far in (*RADII, (-36.0, 0.0), (0.0, 40.0)):
        radius = named(kind, coverage, near, far)
        share = blurred(samples, near)
        for front, back in (*COLORS.values(), (0.3, 0.36)):
            color = (coverage * front + (1 - coverage) * back).expand(3, *SIZE)
            seen = render(color, radius, infinity=100.0, matte=coverage).render[0]
            truth, reach = share * front + (1 - share) * back, max(far, -near)
            found = psnr(seen, truth, coverage, reach, abs(front - back))
            assert found >= 44, (near, far, front, found)


@pytest.mark.parametrize("radii", [(0.0, 9.0), (-9.0, 0.0)])
def test_strands_that_the_depth_lacks_are_of_the_subject_of_the_matte(radii):
    samples, (near, far) = strands(), radii
    coverage, share = blurred(samples, 0), blurred(samples, near)
    radius = torch.where(torch.arange(SIZE[1]) < 42, near, far).double().expand(SIZE)
    color = (coverage * 0.1 + (1 - coverage) * 0.5).expand(3, *SIZE)
    truth = share * 0.1 + (1 - share) * 0.5
    guessed, known = (
        psnr(render(color, radius, matte=matte).render[0], truth, coverage, 9.0, 0.4)
        for matte in (None, coverage)
    )
    assert known > max(guessed + 6, 35), (guessed, known)


@pytest.mark.parametrize("matte", [torch.full(SIZE, 1.5), torch.ones(3, 4), torch.ones(2, *SIZE)])
def test_what_is_no_matte_of_the_picture_is_refused(matte):
    with pytest.raises(ValueError, match=r"matte must be "):
        render(torch.ones(3, *SIZE), torch.zeros(SIZE), matte=matte)


def test_a_matte_of_what_is_behind_changes_no_edge_of_what_is_before_it():
    coverage = blurred(disc(), 0)
    radius = named("centre", coverage, -6.0, 6.0)
    color = (coverage * 0.9 + (1 - coverage) * 0.2).expand(3, *SIZE)
    plain, behind, own = (
        render(color, radius, matte=matte).render for matte in (None, 1 - coverage, coverage)
    )
    assert torch.equal(render(color, radius, matte=torch.zeros(SIZE)).render, plain)
    torch.testing.assert_close(behind, own, atol=2e-3, rtol=0)
