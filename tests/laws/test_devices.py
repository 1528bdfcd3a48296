"""The renderer on a device that is not the CPU: nothing is mixed, and tiles wait for nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import pytest
import torch
from elsewhere import NAME, elsewhere, here, there, waits
from torch import Tensor

from defocus_core import Aperture, DefocusLens, HiddenLayer, RandomDefocus, render, render_layers
from defocus_core.evaluation.law_checks import Check, Setting
from defocus_core.evaluation.law_probes import levels, strips, waves
from defocus_core.evaluation.lens_laws import LAWS, devices, gradient, near_focus, occlusion
from defocus_core.evaluation.synthetic_scenes import scenery
from defocus_core.renderer.engine.region import Region
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.stream import Stream

SIZE = (72, 110)

Moved = Callable[[Tensor], Tensor]


def agree(work: Callable[[Moved], list[Tensor | None]], within: float = 0.0) -> None:
    """Work gives the same on both devices, and on the one that it is given."""
    one = work(lambda values: values)
    with elsewhere():
        other = work(there)
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        if a is None or b is None:
            assert a is b
        else:
            torch.testing.assert_close(here(b), a, rtol=0, atol=within)


def pictures(image: Tensor, radius: Tensor, **options: object) -> list[Tensor | None]:
    found = render(image, radius, **options)  # type: ignore[arg-type]
    return [found.render, found.left, found.right, found.trust]


def scene(kind: str = "cards") -> tuple[Tensor, Tensor]:
    made = scenery(kind, *SIZE, 9.0)
    return made.image, made.signed_radius


@pytest.mark.parametrize("quality", ["draft", "standard", "high", "reference"])
@pytest.mark.parametrize("kind", ["floor", "cards", "lights", "most"])
def test_pictures_do_not_depend_on_the_device(kind: str, quality: str) -> None:
    image, radius = scene(kind)
    with torch.no_grad():
        agree(lambda to: pictures(to(image), to(radius), quality=quality, left_right=True))


@pytest.mark.parametrize(
    "options",
    [
        {"aperture": Aperture(5, 10.0), "left_right": True},
        {"tile": 32},
        {"num_layers": 5},
        {"psf_ks": 41},
        {"infinity": 9.0},
    ],
    ids=str,
)
def test_nor_does_an_option(options: dict[str, object]) -> None:
    image, radius = scene()
    with torch.no_grad():
        agree(lambda to: pictures(to(image), to(radius), **options), within=1e-6)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_nor_a_precision(dtype: torch.dtype) -> None:
    image, radius = scene()
    with torch.no_grad():
        agree(lambda to: pictures(to(image.to(dtype)), to(radius.to(dtype))))


@pytest.mark.parametrize("radius", [strips(SIZE), levels(SIZE), scene("floor")[1].round()])
def test_nor_do_depths_of_every_kind(radius: Tensor) -> None:
    with torch.no_grad():
        agree(lambda to: pictures(to(waves(SIZE)), to(radius)))


@pytest.mark.parametrize("quality", ["draft", "standard", "high"])
def test_nor_what_is_known_to_be_hidden(quality: str) -> None:
    image, radius = scene()
    known = HiddenLayer(image.flip(-1), radius.clamp(min=4) + 3, radius < 0)

    def rendered(to: Moved) -> list[Tensor | None]:
        hidden = HiddenLayer(*map(to, known))
        return pictures(to(image), to(radius), quality=quality, hidden=hidden)

    with torch.no_grad():
        agree(rendered)


@pytest.mark.parametrize("count", [1, 2])
def test_nor_do_layers(count: int) -> None:
    image, radius = scene()
    coverage = torch.stack([(radius < 0).float() * 0.7, torch.ones(SIZE) * 0.9])[:count]
    radii = torch.stack([radius, torch.full(SIZE, 9.0)])[:count]

    def work(to: Moved) -> list[Tensor | None]:
        layers = (image * coverage[:, None], radii, coverage)
        found = render_layers(*map(to, layers), left_right=True)
        return [found.render, found.left, found.right, found.trust]

    with torch.no_grad():
        agree(work)


def test_nor_a_stream() -> None:
    image, radius = scene()

    def rendered(to: Moved) -> list[Tensor | None]:
        parts = Stream(to(image), to(radius), Settings(left_right=True)).regions()
        return [x for p in parts for x in (p.render, p.left, p.right, p.trust)]

    with torch.no_grad():
        agree(rendered)


@pytest.mark.parametrize("quality", ["draft", "standard"])
def test_nor_do_gradients(quality: str) -> None:
    image, radius = (values[..., :40, :60].double() for values in scene())

    def slopes(to: Moved) -> list[Tensor | None]:
        given = [to(values.clone()).requires_grad_() for values in (image, radius)]
        found = render(given[0], given[1], quality=quality, left_right=True)
        assert found.left is not None
        loss = (found.render * 2).sum() + found.left.square().sum()
        return [*torch.autograd.grad(loss, given)]

    agree(slopes, 1e-12)


def test_nor_does_a_lens() -> None:
    image, depth = torch.rand(1, 3, 30, 40), 1000 + 3000 * torch.rand(1, 1, 30, 40)
    point = torch.tensor([0.0, 0.0, -2100.0])

    def made(to: Moved, *, tensors: bool) -> list[Tensor | None]:
        foclen, fnum = (torch.tensor(50.0), torch.tensor(1.8)) if tensors else (50.0, 1.8)
        lens = DefocusLens(to(foclen) if tensors else foclen, to(fnum) if tensors else fnum)
        lens.refocus(2000.0)
        z = to(depth)
        return [
            lens.render_rgbd(to(image), z),
            *lens.render_rgbd_dp(to(image), z),
            *(lens.psf(to(point), ks=80, psf_type=kind) for kind in ("gaussian", "pillbox")),
            *lens.psf_dp(to(point), 80),
            lens.signed_coc(z),
            lens.signed_radius(z),
            lens.dof(z),
        ]

    with torch.no_grad():
        agree(lambda to: made(to, tensors=False), 1e-6)
        agree(lambda to: made(to, tensors=True), 1e-6)


def test_nor_do_random_lenses() -> None:
    image, depth = torch.rand(1, 3, 30, 40), 1000 + 3000 * torch.rand(1, 1, 30, 40)
    lenses = RandomDefocus(quality="draft", left_right=True)

    def taken(to: Moved, seeds: Sequence[int] | Tensor) -> list[Tensor | None]:
        views, drawn = lenses(to(image), to(depth), seeds)
        return [*views.images, views.trust, drawn.signed_radius]

    with torch.no_grad():
        agree(lambda to: taken(to, [3]))
        agree(lambda to: taken(to, to(torch.tensor([3]))))


@pytest.mark.parametrize("kind", ["floor", "cards", "lights"])
def test_tiles_wait_for_nothing(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    image, radius = scene(kind)
    waited: list[object] = []
    tile = Region.tile

    def noted(self: Region, index: int) -> tuple[Tensor, Tensor]:
        before = waits.copy()
        found = tile(self, index)
        waited.append(waits - before)
        return found

    monkeypatch.setattr(Region, "tile", noted)
    with torch.no_grad(), elsewhere():
        render(there(image), there(radius), left_right=True, tile=32)
        assert waits, "a wait is not seen"
    assert len(waited) > 4
    assert not any(waited)


def test_verify_compares_devices() -> None:
    assert devices in LAWS
    with torch.no_grad(), elsewhere():
        (check,) = devices(Setting(NAME, "draft", 1))
    assert check.value is not None
    assert check.ok


@pytest.mark.parametrize("law", [near_focus, occlusion, gradient])
def test_laws_hold_there(law: Callable[[Setting], list[Check]]) -> None:
    with elsewhere():
        assert all(check.ok for check in law(Setting(NAME, "standard", 1)))


def test_who_mixes_devices_is_caught() -> None:
    values = torch.rand(3)
    with elsewhere():
        with pytest.raises(AssertionError, match="two devices"):
            there(values) + values
        with pytest.raises(AssertionError, match="two devices"):
            torch.where(there(values) > 0, torch.ones(3), there(values))
        assert cast(bool, (there(values) + 1.0 > 0).all())
        assert waits["aten::_local_scalar_dense"] == 1
