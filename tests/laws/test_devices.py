"""The renderer on a device that is not the CPU: nothing is mixed, and tiles wait for nothing."""

from typing import cast

import pytest
import torch
from elsewhere import CPU, DEVICES, NAME, elsewhere, there, waits
from launches import Launches
from renderers import renderer_of
from synthetic_scenes import scenery

from defocus_core import (
    Aperture,
    CatEye,
    DefocusLens,
    Distribution,
    DualPixel,
    HiddenLayer,
    PupilImage,
    RandomDefocus,
    render,
    render_layers,
    with_lights,
)
from defocus_core.evaluation.lens_laws import LAWS, LawSetting, strips, waves
from defocus_core.fitting.pictures import Scale, clipped
from defocus_core.fitting.residual import Point, Residual
from defocus_core.renderer.engine import regions
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors import device_plan

# The compiled back is of the CPU alone: what devices have in common is the other one.
pytestmark = pytest.mark.usefixtures("torch_back")

SIZE = (56, 80)

# A disc that has lost a side.
_V = torch.linspace(-1, 1, 15)
_DISC = (_V**2 + (_V**2)[:, None] <= 1).double()
PUPIL = PupilImage(_DISC * (_V < 0.4))

each_device = pytest.mark.parametrize("device", DEVICES)
anywhere = pytest.mark.parametrize("device", [*DEVICES, pytest.param(CPU, id="cpu")])


def require_alike(device, work, within=0.0):
    """Assert that work gives the same on both devices, and on the one that it is given."""
    one = work(lambda values: values)
    with device.known():
        other = [None if x is None else device.here(x) for x in work(device.there)]
    for a, b in zip(one, other, strict=True):
        if a is None:
            assert b is None
        else:
            torch.testing.assert_close(b, a, rtol=0, atol=max(within, device.within))


def pictures(image, radius, **options):
    found = render(image, radius, **options)
    return [found.render, found.left, found.right, found.trust]


def scene(kind="cards", size=SIZE):
    made = scenery(kind, *size, 6.0)
    return made.image, made.signed_radius


def picture_of(kind="cards", dtype=torch.float32, radius=None, **options):
    """A work: the views of a scene."""
    image, depth = scene(kind)
    depth = depth if radius is None else radius
    return lambda to: pictures(to(image.to(dtype)), to(depth.to(dtype)), **options)


def of_hidden(to):
    image, radius = scene()
    known = HiddenLayer(to(image.flip(-1)), to(radius.clamp(min=4) + 3), to(radius < 0))
    return pictures(to(image), to(radius), quality="high", hidden=known)


def layers(count):
    image, radius = scene()
    coverage = torch.stack([(radius < 0).float() * 0.7, torch.ones(SIZE) * 0.9])[:count]
    radii = torch.stack([radius, torch.full(SIZE, 9.0)])[:count]
    given = image * coverage[:, None], radii, coverage

    def work(to):
        found = render_layers(*map(to, given), left_right=True)
        return [found.render, found.left, found.right, found.trust]

    return work


def tiles(to):
    image, radius = map(to, scene())
    parts = renderer_of(image, radius, left_right=True).tiles()
    return [x for p in parts for x in (p.render, p.left, p.right, p.trust)]


def gradients(to):
    given = [to(x[..., :24, :40].double()).requires_grad_() for x in scene()]
    with torch.enable_grad():
        found = render(given[0], given[1], left_right=True)
        loss = (found.render * 2).sum() + found.left.square().sum()
    return [*torch.autograd.grad(loss, given)]


def lens(*, tensors):
    image, depth = waves((30, 40))[None], 1500 + 1000 * waves((30, 40))[None, :1]
    point = torch.tensor([0.0, 0.0, -2100.0])

    def work(to):
        given = (to(torch.tensor(50.0)), to(torch.tensor(5.6))) if tensors else (50.0, 5.6)
        made, z = DefocusLens(*given), to(depth)
        made.refocus(2000.0)
        return [
            made.render_rgbd(to(image), z),
            *made.render_rgbd_dp(to(image), z),
            *(made.psf(to(point), ks=80, psf_type=kind) for kind in ("gaussian", "pillbox")),
            *made.psf_dp(to(point), 80),
            made.coc(z),
            made.signed_radius(z),
            made.dof(z),
        ]

    return work


def random_lenses(to):
    image, depth = waves((30, 40))[None], 1000 + 3000 * waves((30, 40))[None, :1]
    views, drawn = RandomDefocus(left_right=True)(to(image), to(depth), to(torch.tensor([3])))
    return [*views.images, views.trust, drawn.signed_radius]


def lights(to):
    return [with_lights(to((scene()[0] * 2).clamp(max=1)), 0.8, 4.0)]


def fitted(to):
    image, disparity = waves((64, 64)), torch.linspace(0, 1, 64)[:, None].repeat(1, 64)
    seen = render(image, 8 * (0.4 - disparity)).render
    whole = Scale(to(image), to(disparity), to(seen)[None], clipped(to(image)))
    residual = Residual(whole, Settings(infinity=0.0, back="torch"), exposure=True)
    point = Point(far=3.4, near=-5.1, across=0.5, growth=0.01)
    return [x for scale in (whole, whole.reduced(32)) for x in residual.differences(point, scale)]


# What is computed, and the most that it may differ by, beside what the device may.
WORKS = {
    "floor": (picture_of("floor", left_right=True), 0),
    "lights": (picture_of("lights", left_right=True), 0),
    "high": (picture_of("most", quality="high", left_right=True), 0),
    "reference": (picture_of(quality="reference", left_right=True), 0),
    "float16": (picture_of(dtype=torch.float16), torch.finfo(torch.float16).eps),
    "float64": (picture_of(dtype=torch.float64), 0),
    "strips": (picture_of(radius=strips(SIZE)), 0),
    "planes": (picture_of(radius=scene("floor")[1].round()), 0),
    "blades": (
        picture_of(left_right=True, aperture=Aperture(5, 10.0, obstruction=0.4, spherical=0.5)),
        1e-6,
    ),
    "pupil": (
        picture_of(aperture=Aperture(image=PUPIL), num_layers=5, psf_ks=41, edge_width=12.0),
        1e-6,
    ),
    "cat's eye": (picture_of(cat_eye=CatEye(1.1, 0.5), infinity=9.0, tile=32), 1e-6),
    "colours": (picture_of(color_offsets=(0.6, 0.0, -0.4)), 1e-6),
    "dual pixel": (picture_of(dual_pixel=DualPixel(crosstalk=0.3), left_right=True), 1e-6),
    "hidden": (of_hidden, 0),
    "one layer": (layers(1), 0),
    "layers": (layers(2), 0),
    "tiles": (tiles, 0),
    "gradients": (gradients, 1e-12),
    "lens": (lens(tensors=False), 1e-6),
    "lens of tensors": (lens(tensors=True), 1e-6),
    "random lenses": (random_lenses, 0),
    "clipped lights": (lights, 0),
    "fit": (fitted, 1e-5),
}


@each_device
@pytest.mark.parametrize("name", WORKS)
def test_nothing_depends_on_the_device(name, device):
    work, within = WORKS[name]
    with torch.no_grad():
        require_alike(device, work, within)


@each_device
def test_little_memory_makes_more_tiles_of_the_same_picture(device, monkeypatch):
    image, radius = scene("cards")
    count: list[int] = []

    def work(to):
        views = render(to(image), to(radius))
        count.append(views.stats["tiles"])
        return [views.render]

    with torch.no_grad():
        for memory in (1 << 33, 1 << 21):
            monkeypatch.setattr(device_plan, "memory_of", lambda device, memory=memory: memory)
            require_alike(device, work)
    assert count[1] == 1 < count[3]


@each_device
@pytest.mark.parametrize("kind", ["floor", "cards", "lights"])
def test_tiles_wait_for_nothing(device, kind, monkeypatch):
    image, radius = scene(kind)
    waited: list[int] = []
    tile = regions.Region.tile

    def noted(self, index):
        with Launches(device.name) as counts:
            found = tile(self, index)
        waited.append(counts.waits)
        return found

    monkeypatch.setattr(regions.Region, "tile", noted)
    with torch.no_grad(), device.known(), Launches(device.name) as every:
        render(device.there(image), device.there(radius), left_right=True, tile=32)
    assert every.waits, "a wait is not seen"
    assert len(waited) > 4
    assert not any(waited)


def test_backward_passes_wait_for_regions_alone(monkeypatch):
    planned, plan = [], regions.region_of

    def noted(*args):
        before = waits()
        try:
            return plan(*args)
        finally:  # a pass that has what it needs leaves
            planned.append(waits() - before)

    with elsewhere():
        given = [there(values.clone()).requires_grad_() for values in scene(size=(40, 60))]
        seen = render(given[0], given[1], tile=64).render
        monkeypatch.setattr(regions, "region_of", noted)
        first = waits()
        torch.autograd.grad(seen.sum(), given)
    assert 0 < waits() - first == sum(planned)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_nor_do_they_on_a_gpu(monkeypatch):
    image, radius = (x.cuda().requires_grad_() for x in scene())
    seen, plan = render(image, radius, left_right=True).render.sum(), regions.region_of

    def waiting(*args):
        torch.cuda.set_sync_debug_mode("default")
        try:
            return plan(*args)
        finally:
            torch.cuda.set_sync_debug_mode("error")

    monkeypatch.setattr(regions, "region_of", waiting)
    torch.cuda.set_sync_debug_mode("error")
    try:
        seen.backward()
    finally:
        torch.cuda.set_sync_debug_mode("default")


@anywhere
def test_a_batch_is_its_pictures(device):
    # of other ranges of radius, one with highlights: no two plans are the same
    images, radii = zip(*(scene(kind, (41, 52)) for kind in ("floor", "most")), strict=True)
    images, radii = torch.stack(images), torch.stack(radii) * torch.tensor([0.3, 0.9]).view(2, 1, 1)
    options = {"left_right": True, "aperture": Aperture(5, 10.0), "cat_eye": CatEye(1.1, 0.5)}
    with torch.no_grad(), device.known():
        given = device.there(images), device.there(radii)
        batch = pictures(*given, **options)
        for n, pair in enumerate(zip(*given, strict=True)):
            for together, alone in zip(batch, pictures(*pair, **options), strict=True):
                within = 0.0 if device.name != "cuda" else device.within
                a, b = device.here(together[n]), device.here(alone)
                torch.testing.assert_close(a, b, rtol=0, atol=within)


@anywhere
def test_a_batch_of_random_lenses_is_its_pictures_with_their_gradients(device):
    size = (18, 24)
    images = torch.stack([scene("cards", size)[0]] * 2)
    floor = torch.linspace(2000, 600, size[0])[:, None].repeat(1, size[1])
    depth = torch.stack([floor, floor + 40])
    squeeze = torch.tensor(1.2, requires_grad=True)
    look = {"left_right": True, "squeeze": squeeze, "cat_eye_size": 1.2, "sensor_width": 12.0}
    look |= {"crosstalk": Distribution("uniform", (0.0, 0.3))}

    def taken(numbers):
        given = [device.there(x[numbers].clone()).requires_grad_() for x in (images, depth)]
        views, _ = RandomDefocus(**look)(*given, numbers)
        slopes = torch.autograd.grad(views.render.square().sum(), [*given, squeeze])
        return [device.here(x) for x in (*views.images, views.trust, *slopes[:2])], slopes[2]

    with device.known():
        (first, one), (second, other) = taken([0]), taken([1])
        together, both = taken([0, 1])
    within = 1e-4 if device.name == "cuda" else 0.0  # whose sums come in any order
    for batch, alone in zip(together, map(torch.cat, zip(first, second, strict=True)), strict=True):
        torch.testing.assert_close(batch, alone, rtol=within, atol=within)
    torch.testing.assert_close(both, one + other)


@pytest.mark.parametrize("law", [law for law in LAWS if law.name in ("disc", "gradient")])
def test_laws_hold_there(law):
    with elsewhere():
        assert max(law.numbers(LawSetting(NAME))) <= law.bound


def test_who_mixes_devices_is_caught():
    values = torch.rand(3)
    with elsewhere():
        with pytest.raises(AssertionError, match="two devices"):
            there(values) + values
        with pytest.raises(AssertionError, match="two devices"):
            torch.where(there(values) > 0, torch.ones(3), there(values))
        assert cast(bool, (there(values) + 1.0 > 0).all())
        assert waits() == 1
