"""Pixels on edges of estimated depth belong to the surface that their colour shows."""

import pytest
import torch
from scenes import RADII, pattern
from torch import Tensor

from defocus_core import render
from defocus_core.depth.edge_pixels import AROUND, are_beside_their_surface, with_pixels_by_color
from defocus_core.renderer.layers.matting import Unmixed, unmixed
from defocus_core.tensors.box import Box
from defocus_core.tensors.derived import Repaired

SIZE = (40, 60)
MIDDLE = SIZE[1] // 2


def half_planes(end: int) -> Tensor:
    """Radii 0 before a column, 12 from it on."""
    radius = torch.zeros(SIZE, dtype=torch.float64)
    radius[:, end:] = 12.0
    return radius


def two_colors(contrast: float = 1.0, texture: float = 0.2) -> Tensor:
    near, far = (torch.tensor(c).double()[:, None, None] for c in ([0.05, 0.5, 0.1], [0.5, 0.1, 0]))
    near = far + contrast * (near - far)
    image = torch.where(half_planes(MIDDLE) == 0, near, far)
    return image * (1 + texture * (pattern(SIZE, period=9.0) - 0.5))


def ragged(seed: int, size: tuple[int, int] = SIZE) -> tuple[Tensor, Tensor, Tensor]:
    """Blobs of two colours, radii whose edges lie about a px beside theirs, and true radii."""
    generator = torch.Generator().manual_seed(seed)

    def waves(cells: int) -> Tensor:
        coarse = torch.randn(1, 1, size[0] // cells, size[1] // cells, generator=generator)
        return torch.nn.functional.interpolate(coarse, size, mode="bicubic")[0, 0].double()

    blobs, off = waves(10), 0.15 * waves(4)
    color = torch.rand(3, 2, generator=generator).double()
    image = torch.where(blobs > 0, color[:, :1, None], color[:, 1:, None])
    image = image * (0.9 + 0.2 * torch.rand(*size, generator=generator).double())
    found, true = (torch.where(height > 0, 14.0, 0.0).double() for height in (blobs + off, blobs))
    return image, found, true


@pytest.mark.parametrize("by", [-1, 0, 1])
@pytest.mark.parametrize("contrast", [0.3, 1.0])
def test_an_edge_a_pixel_off_comes_to_where_the_colours_change(by: int, contrast: float) -> None:
    found = with_pixels_by_color(half_planes(MIDDLE + by), two_colors(contrast))
    assert torch.equal(found, half_planes(MIDDLE))


def test_where_colours_say_nothing_a_straight_edge_stays_and_teeth_go() -> None:
    image, straight = torch.full((3, *SIZE), 0.4).double(), half_planes(MIDDLE)
    assert torch.equal(with_pixels_by_color(straight, image), straight)
    ragged_edge = straight.clone()
    ragged_edge[10, MIDDLE], ragged_edge[20, MIDDLE - 1] = 0.0, 12.0
    assert torch.equal(with_pixels_by_color(ragged_edge, image), straight)


@pytest.mark.parametrize("kind", ["flat", "slanted"])
def test_depth_without_edges_stays(kind: str) -> None:
    radius = RADII.get(kind, lambda size: torch.full(size, 3.0).double())(SIZE)
    assert with_pixels_by_color(radius, two_colors()) is radius


@pytest.mark.parametrize("seed", range(4))
def test_most_pixels_beside_their_surface_come_back(seed: int) -> None:
    image, radius, true = ragged(seed)
    found = with_pixels_by_color(radius, image)
    before, after = (int((r != true).sum()) for r in (radius, found))
    assert before > 20
    assert after < 0.5 * before


@pytest.mark.parametrize("dims", [(-1,), (-2,), (-1, -2)])
def test_mirrored_pictures_are_mirrored(dims: tuple[int, ...]) -> None:
    image, radius, _ = ragged(1)
    radius = radius + 0.01 * pattern(SIZE)[0]
    found = with_pixels_by_color(radius, image)
    assert bool((found != radius).any())
    mirrored = with_pixels_by_color(radius.flip(dims), image.flip(dims)).flip(dims)
    assert torch.equal(mirrored, found)
    turned = with_pixels_by_color(radius.T.contiguous(), image.mT.contiguous()).T
    assert torch.equal(turned, found)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
@pytest.mark.parametrize("exposure", [1e-3, 1.0, 100.0])
def test_precision_and_exposure_decide_nothing(dtype: torch.dtype, exposure: float) -> None:
    image = (exposure * two_colors()).to(dtype)
    found = with_pixels_by_color(half_planes(MIDDLE + 1).to(dtype), image)
    assert torch.equal(found, half_planes(MIDDLE).to(dtype))


def test_a_window_holds_what_the_whole_holds() -> None:
    image, radius, _ = ragged(2, (90, 120))
    whole, lazily = (
        with_pixels_by_color(radius, image),
        Repaired(radius, with_pixels_by_color, AROUND, image),
    )
    for box in (Box(31, 40, 30, 40), Box(0, 50, 17, 64), Box(60, 0, 30, 120)):
        assert torch.equal(box.of(lazily), box.of(whole))


def test_each_radius_has_one_source() -> None:
    image, radius, _ = ragged(3)
    given = radius.requires_grad_()
    weights = torch.rand(SIZE, generator=torch.Generator().manual_seed(1)).double()
    (with_pixels_by_color(given, image) * weights).sum().backward()
    assert given.grad is not None
    assert float(given.grad.sum()) == pytest.approx(float(weights.sum()))
    assert bool((given.grad >= 0).all())


@pytest.mark.parametrize("seed", range(2))
def test_depth_of_half_the_size_makes_nearly_the_picture_of_the_whole(seed: int) -> None:
    image, _, radius = ragged(seed, (120, 160))
    half = torch.nn.functional.interpolate(
        radius[None, None, ::2, ::2], radius.shape, mode="bilinear", align_corners=False
    )[0, 0]
    true = render(image, radius).render
    auto, off = (
        float((render(image, half, depth_repair=switch).render - true).square().mean())
        for switch in ("auto", "off")
    )
    assert auto < 0.05 * off


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("factor", [2, 4])
def test_averages_of_an_enlarged_depth_map_are_told_from_those_of_pixels(
    seed: int, factor: int
) -> None:
    """Averages of pixels say where edges are; of larger ones, colours do."""
    image, _, radius = ragged(seed, (120, 160))
    coarse = radius[None, None, ::factor, ::factor].repeat_interleave(factor, 2)
    coarse = coarse.repeat_interleave(factor, 3)[0, 0]
    assert not are_beside_their_surface(radius, image, 2)
    assert are_beside_their_surface(coarse, image, 2)


def coverage_of(surface: Unmixed, column: int) -> Tensor:
    assert surface.coverage is not None
    return surface.coverage[0, :, column]


@pytest.mark.parametrize("alpha", [0.4, 0.6])
def test_uncertain_edges_are_taken_apart_by_less_contrast(alpha: float) -> None:
    """Colours as alike as these leave a pixel of certain depth whole."""
    radius, image = half_planes(MIDDLE), two_colors(0.1, texture=0.0)
    column = MIDDLE - 1 if alpha > 0.5 else MIDDLE
    inside, outside = image[:, :, MIDDLE - 5], image[:, :, MIDDLE + 5]
    image[:, :, column] = alpha * inside + (1 - alpha) * outside
    image += 0.008 * torch.randn(image.shape, generator=torch.Generator().manual_seed(1))
    certain, uncertain = (unmixed(image, radius, uncertain=u) for u in (False, True))
    minimum, maximum = (
        float((u.fringe.layer[:, -1] if alpha < 0.5 else 1 - coverage_of(u, column)).sum())
        for u in (certain, uncertain)
    )
    assert minimum < 0.02 * SIZE[0]
    assert 0.1 * SIZE[0] < maximum < 0.4 * SIZE[0]
