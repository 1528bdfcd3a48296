"""Law 9: the shipped renderer is differentiable in image, depth and lens parameters."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from extremes import Extreme
from measures import worst
from renderers import QUALITIES
from scenes import RADII, pattern, slanted
from synthetic_scenes import scenery
from torch import Tensor
from torch.autograd import gradcheck
from torch.autograd.forward_ad import dual_level, make_dual

from defocus_core import DefocusLens, HiddenLayer, RandomDefocus, render

SIZE = (9, 11)
PIXEL = 36.0 / 480  # mm


def picture(channels=2):
    return torch.rand(channels, *SIZE, generator=torch.Generator().manual_seed(5)).double()


def slope_with_a_card():
    """A slope through focus and a nearer card before it, radii off the slice radii."""
    slope = torch.linspace(-2.3, 2.6, SIZE[1]).double() + torch.linspace(0, 0.3, SIZE[0])[:, None]
    slope[3:6, 4:8] -= 3.1
    return slope.requires_grad_()


@pytest.mark.parametrize("quality", ["standard", "high"])
def test_gradients_to_the_image_are_exact(quality):
    radius = slope_with_a_card().detach()

    def pictures(image):
        o = render(image, radius, quality=quality, left_right=True)
        return o.render, o.left

    assert gradcheck(pictures, (picture().requires_grad_(),), atol=1e-6, fast_mode=True)


def test_gradients_to_depth_and_lens_are_exact():
    image = picture()[None]
    depth = torch.linspace(1800, 2300, SIZE[1]).double().expand(1, 1, *SIZE).clone()

    def defocused(foclen, fnum, foc_dist, z):
        sensor = (PIXEL * SIZE[1], PIXEL * SIZE[0])
        lens = DefocusLens(foclen, fnum, sensor, SIZE[::-1], dtype=torch.float64)
        lens.refocus(foc_dist)
        return lens.render_rgbd(image, z)

    lens = [torch.tensor(x, dtype=torch.float64).requires_grad_() for x in (50.0, 2.0, 2000.0)]
    given = (*lens, depth.requires_grad_())
    assert gradcheck(defocused, given, eps=1e-5, atol=1e-5, fast_mode=True)


@pytest.mark.parametrize("door", ["render", "lens", "random"])
@pytest.mark.parametrize("transform", ["jvp", "vmap", "grad", "dual"])
def test_what_would_lose_a_derivative_is_refused(transform, door):
    image, depth = picture().float()[None], torch.full((1, *SIZE), 1500.0)

    def rendered(image):
        if door == "render":
            return render(image, depth / 1000).render
        if door == "random":
            return RandomDefocus()(image, depth, [1])[0].render
        return DefocusLens(50.0, 2.0, (36.0, 36.0), (11, 11)).render_rgbd(image, depth)

    def dual():
        with dual_level():
            rendered(make_dual(image, image))

    transforms: dict[str, Callable[[], object]] = {
        "jvp": lambda: torch.func.jvp(rendered, (image,), (image,)),
        "vmap": lambda: torch.func.vmap(rendered)(image[None]),
        "grad": lambda: torch.func.grad(lambda image: rendered(image).sum())(image),
        "dual": dual,
    }
    with pytest.raises(ValueError, match="image must be a tensor of its own"):
        transforms[transform]()


def test_second_derivatives_and_tensors_without_values_are_refused():
    image, radius = picture().float().requires_grad_(), torch.full(SIZE, 3.0)
    energy = render(image, radius).render.square().sum()
    with pytest.raises(ValueError, match="create_graph must be False"):
        torch.autograd.grad(energy, image, create_graph=True)
    with pytest.raises(ValueError, match="image must hold values, got one on meta"):
        render(image.to("meta"), radius.to("meta"))


@pytest.mark.parametrize("door", ["render", "lens", "random"])
def test_a_compiled_caller_gets_the_same(door):
    """It leaves the renderer as it is; the backend eager traces as every other does."""
    image, depth = picture().float()[None].requires_grad_(), torch.full((1, *SIZE), 3000.0)
    depth[..., 5:] = 1500.0
    lens, random = DefocusLens(50.0, 2.0, (36.0, 36.0), (11, 11)), RandomDefocus(max_radius=4.0)
    doors: dict[str, Callable[[Tensor], Tensor]] = {
        "render": lambda image: render(image, depth / 1000).render,
        "lens": lambda image: lens.render_rgbd(image, depth),
        "random": lambda image: random(image, depth, [1])[0].render,
    }

    def loss(image):
        return doors[door]((2 * image).sin()).cos().sum()

    compiled = torch.compile(loss, backend="eager")
    for found, wanted in zip(
        (compiled(image), *torch.autograd.grad(compiled(image), image)),
        (loss(image), *torch.autograd.grad(loss(image), image)),
        strict=True,
    ):
        torch.testing.assert_close(found, wanted)


def test_a_highlight_passes_its_gradient():
    image, radius = torch.full((1, 24, 24), 0.1).double(), torch.full((24, 24), 4.2).double()
    image[0, 12, 12] = 900.0
    image.requires_grad_()
    radius.requires_grad_()
    render(image, radius).render[0, 12, 12].backward()
    assert image.grad[0, 12, 12] == pytest.approx(1 / (torch.pi * 4.2**2), rel=0.02)
    # brightness in the disc is 900 / π r²: its slope is -2 / r of that
    assert radius.grad[12, 12] == pytest.approx(-2 / 4.2 * 900 / (torch.pi * 4.2**2), rel=0.1)


def test_gradients_to_what_stands_before_a_light_are_exact():
    """Pixels on the silhouette are taken apart: colours and radii say how much they cover."""
    image, radius = 0.1 * picture(3)[:, :7], slope_with_a_card().detach()[:7]
    radius = torch.where(radius < -1.5, radius - 1, 3.1).requires_grad_()
    image[:, 4, 9] = 40.0

    def pictures(image, radius):
        return render(image, radius, depth_repair="off").render

    assert gradcheck(pictures, (image.requires_grad_(), radius), atol=1e-5, fast_mode=True)


@pytest.mark.parametrize("quality", ["standard", "high"])
@pytest.mark.parametrize(("near", "far"), [(-5.137, 2.317), (0.213, 5.71), (-4.41, -0.77)])
def test_gradients_before_a_known_layer_are_those_by_differences(near, far, quality):
    """How far a lens sees past what hides a layer hangs on the radii, and so does its gradient."""
    drawn = torch.Generator().manual_seed(4)
    image, color, weigh = torch.rand(3, 3, 26, 34, generator=drawn).double()
    y, x = torch.arange(26).double()[:, None], torch.arange(34).double()
    card = ((x - 15).abs() < 6) & ((y - 12).abs() < 7)
    off = 0.003 * torch.rand(2, 26, 34, generator=drawn).double()
    radius = torch.where(card, near + 0.013 * x + 0.007 * y, far + 0.011 * x - 0.005 * y) + off[0]
    behind = far + 0.0537 + 0.017 * x + 0.003 * y + off[1]

    def seen(by):
        hidden = HiddenLayer(color, behind + by[1], torch.ones_like(card))
        options: dict[str, Any] = {"quality": quality, "depth_repair": "off", "hidden": hidden}
        return (weigh * render(image, radius + by[0] * card, **options).render).sum()

    zero = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(seen(zero), zero)
    for axis in torch.eye(2, dtype=torch.float64):
        with torch.no_grad():
            slopes = [float(seen(h * axis) - seen(-h * axis)) / (2 * h) for h in (1e-5, 1e-6)]
        assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)
        assert float(gradient @ axis) == pytest.approx(slopes[1], rel=1e-4)


def test_gradients_in_float32_are_those_in_float64():
    """Of every pixel of waves on a slant: behind what covers all, layers are rounding alone."""

    def slopes(dtype):
        radius = slanted(near=-5.87, far=8.91).to(dtype).requires_grad_()
        image = pattern(period=14.0).to(dtype)
        render(image, radius, left_right=True).render.square().mean().backward()
        return radius.grad

    exact = slopes(torch.float64)
    assert worst(slopes(torch.float32), exact) < 0.01 * float(exact.abs().max())


@pytest.mark.parametrize("kind", ["steps", "slanted"])
def test_what_is_rendered_without_gradients_may_take_part_in_later_ones(kind):
    """And what is kept from one picture to the next, like shares beside the border."""
    image, radius = pattern((20, 26)), RADII[kind]((20, 26))
    with torch.no_grad():
        plain = render(image, radius, left_right=True)
    weight = torch.ones_like(image, requires_grad=True)
    (plain.render * weight * plain.left * plain.trust).sum().backward()
    wanted = radius.clone().requires_grad_()
    seen = render(image, wanted, left_right=True)
    assert worst(seen.render.detach(), plain.render) < 1e-9
    seen.render.sum().backward()
    with torch.inference_mode():
        assert worst(render(image, radius).render, plain.render) < 1e-9


# one number of the pupil or the rim, others beside it, and the ends of its range
BLADES = {"blades": 3, "rotation": 20.0}
VIGNETTED = {"size": 1.0, "shift": 0.4, "vignetting": True}
NUMBERS: list[tuple[str, str, float, tuple[float, float], dict[str, Any]]] = [
    ("standard", "obstruction", 0.0, (0.0, 0.95), {}),
    ("high", "obstruction", 0.3, (0.0, 0.95), {}),
    ("reference", "obstruction", 0.3, (0.0, 0.95), {}),
    ("reference", "squeeze", 0.6, (0.05, 20.0), {}),
    ("standard", "squeeze", 20.0, (0.05, 20.0), {}),
    ("standard", "curvature", 0.0, (0.0, 1.0), BLADES),
    ("standard", "curvature", 0.4, (0.0, 1.0), BLADES),
    ("standard", "curvature", 1.0, (0.0, 1.0), BLADES),
    ("standard", "spherical", -1.0, (-1.0, 1.0), {}),
    ("standard", "spherical", 1.0, (-1.0, 1.0), {}),
    ("standard", "size", 0.8, (0.5, 2.0), {}),
    ("standard", "shift", 0.4, (0.0, 0.9), {}),
]


@pytest.mark.parametrize(("quality", "name", "value", "ends", "others"), NUMBERS)
def test_gradients_to_the_shape_of_the_pupil_are_those_by_differences(
    quality, name, value, ends, others
):
    rim = {**VIGNETTED, name: value} if name in VIGNETTED else {}
    pupil = {**others, **({} if rim else {name: value})}
    options = {"quality": quality}
    shot = Extreme(pupil=pupil, rim=rim, learnt=name, options=options)
    image, radius = picture(3)[:, 1:7, 2:9], 0.5 * slope_with_a_card().detach()[1:7, 2:9]
    image[0, 3, 3] = 30.0
    weigh = torch.rand(3, *image.shape, generator=torch.Generator().manual_seed(1)).double()

    def seen(number):
        views = shot.views(image, radius, number)
        return (torch.stack(list(views.images)) * weigh).sum() + views.trust.sum()

    number = torch.tensor(value, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(seen(number), number)
    step, (minimum, maximum) = 1e-5, ends
    is_inside = minimum <= value - step and value + step <= maximum
    by = step if value + step <= maximum else -step  # into the range
    first, second, third = (
        float(seen(torch.tensor(value + by * k, dtype=torch.float64)))
        for k in (0, 1, -1 if is_inside else 2)
    )
    slope = (second - third if is_inside else 4 * second - 3 * first - third) / (2 * by)
    assert float(gradient) == pytest.approx(slope, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("kind", ["cards", "floor"])
def test_gradients_do_not_hang_on_rounding(kind, quality):
    """Cards lie on slices, and cover pixels fully but for the last bit; the floor has no ties."""
    made = scenery(kind, 72, 110, 9.0)
    image, radius = (x[..., :24, :40].double() for x in (made.image, made.signed_radius))
    by = 1e-15 * torch.randn(radius.shape, generator=torch.Generator().manual_seed(0)).double()

    def gradients(r):
        given = (image.clone().requires_grad_(), r.clone().requires_grad_())
        seen = render(*given, quality=quality, left_right=True)
        return torch.autograd.grad(2 * seen.render.sum() + seen.left.square().sum(), given)

    for one, other in zip(gradients(radius), gradients(radius * (1 + by)), strict=True):
        torch.testing.assert_close(other, one, rtol=0, atol=1e-6)


@pytest.mark.parametrize("radius", [0.75, 4.5])
def test_on_a_slice_the_derivative_is_between_those_of_both_sides(radius):
    image = torch.rand(1, 24, 24, generator=torch.Generator().manual_seed(3)).double()
    radii = torch.full((24, 24), radius).double().requires_grad_()
    (slope,) = torch.autograd.grad(render(image, radii, depth_repair="off").render.sum(), radii)
    step = torch.zeros(24, 24).double()
    step[12, 12] = 1e-6
    with torch.no_grad():
        before, at, after = (
            float(render(image, radii + by * step, depth_repair="off").render.sum())
            for by in (-1, 0, 1)
        )
    sides = sorted(((at - before) / 1e-6, (after - at) / 1e-6))
    assert sides[0] - 1e-4 <= float(slope[12, 12]) <= sides[1] + 1e-4
    assert abs(float(slope[12, 12])) > 1e-3
