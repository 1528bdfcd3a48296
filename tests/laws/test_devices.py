"""The renderer on a device that is not the CPU: nothing is mixed, and tiles wait for nothing."""

from typing import cast

import pytest
import torch
from elsewhere import CPU, DEVICES, NAME, Device, elsewhere, there, waits
from launches import Launches
from torch import Tensor

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
from defocus_core.evaluation.synthetic_scenes import scenery
from defocus_core.fitting.pictures import Scale, clipped
from defocus_core.fitting.residual import Point, Residual
from defocus_core.renderer.engine import regions
from defocus_core.renderer.engine.regions import Region
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors import device_plan

SIZE = (56, 80)

# A disc that has lost a side.
_V = torch.linspace(-1, 1, 15)
_DISC = (_V**2 + (_V**2)[:, None] <= 1).double()
PUPIL = PupilImage(_DISC * (_V < 0.4))


@pytest.fixture(params=DEVICES)
def device(request):
    """Each device that there is beside the CPU."""
    found: Device = request.param
    return found


@pytest.fixture(params=[*DEVICES, pytest.param(CPU, id="cpu")])
def anywhere(request):
    """Each device, the CPU included."""
    found: Device = request.param
    return found


@pytest.fixture
def agree(device):
    """Asserts that work gives the same on both devices, and on the one that it is given."""

    def agreeing(work, within=None):
        one = work(lambda values: values)
        with device.known():
            other = work(device.there)
            other = [None if x is None else device.here(x) for x in other]
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            if a is None or b is None:
                assert a is b
            else:
                maximum = device.within if within is None else max(within, device.within)
                torch.testing.assert_close(b, a, rtol=0, atol=maximum)

    return agreeing


def pictures(image, radius, **options):
    found = render(image, radius, **options)
    return [found.render, found.left, found.right, found.trust]


def scene(kind="cards", size=SIZE):
    made = scenery(kind, *size, 6.0)
    return made.image, made.signed_radius


@pytest.mark.parametrize(
    ("kind", "quality"),
    [("floor", "standard"), ("lights", "standard"), ("most", "high"), ("cards", "reference")],
)
def test_pictures_do_not_depend_on_the_device(agree, kind, quality):
    image, radius = scene(kind)
    with torch.no_grad():
        agree(lambda to: pictures(to(image), to(radius), quality=quality, left_right=True))


@pytest.mark.parametrize(
    "options",
    [
        {"aperture": Aperture(5, 10.0, obstruction=0.4, spherical=0.5), "left_right": True},
        {"aperture": Aperture(image=PUPIL), "num_layers": 5, "psf_ks": 41, "edge_width": 12.0},
        {"cat_eye": CatEye(1.1, 0.5), "infinity": 9.0, "tile": 32},
        {"color_offsets": (0.6, 0.0, -0.4)},
        {"dual_pixel": DualPixel(crosstalk=0.3), "left_right": True},
    ],
    ids=lambda options: "-".join(options),
)
def test_nor_does_an_option(agree, options):
    image, radius = scene()
    with torch.no_grad():
        agree(lambda to: pictures(to(image), to(radius), **options), within=1e-6)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64])
def test_nor_a_precision(agree, dtype):
    image, radius = scene()
    with torch.no_grad():
        rounding = 0.0 if dtype == torch.float64 else torch.finfo(dtype).eps
        agree(lambda to: pictures(to(image.to(dtype)), to(radius.to(dtype))), rounding)


@pytest.mark.parametrize("radius", [strips(SIZE), scene("thin")[1], scene("floor")[1].round()])
def test_nor_do_depths_of_every_kind(agree, radius):
    with torch.no_grad():
        agree(lambda to: pictures(to(waves(SIZE)), to(radius)))


@pytest.mark.parametrize("quality", ["standard", "high"])
def test_nor_what_is_known_to_be_hidden(agree, quality):
    image, radius = scene()
    known = HiddenLayer(image.flip(-1), radius.clamp(min=4) + 3, radius < 0)

    def rendered(to):
        hidden = HiddenLayer(*map(to, known))
        return pictures(to(image), to(radius), quality=quality, hidden=hidden)

    with torch.no_grad():
        agree(rendered)


@pytest.mark.parametrize("count", [1, 2])
def test_nor_do_layers(agree, count):
    image, radius = scene()
    coverage = torch.stack([(radius < 0).float() * 0.7, torch.ones(SIZE) * 0.9])[:count]
    radii = torch.stack([radius, torch.full(SIZE, 9.0)])[:count]

    def work(to):
        layers = (image * coverage[:, None], radii, coverage)
        found = render_layers(*map(to, layers), left_right=True)
        return [found.render, found.left, found.right, found.trust]

    with torch.no_grad():
        agree(work)


def test_nor_do_tiles(agree):
    image, radius = scene()

    def rendered(to):
        parts = Renderer(Scene(to(image), to(radius)), Settings(left_right=True)).tiles()
        return [x for p in parts for x in (p.render, p.left, p.right, p.trust)]

    with torch.no_grad():
        agree(rendered)


def test_nor_do_gradients(agree):
    image, radius = (values[..., :24, :40].double() for values in scene())

    def slopes(to):
        given = [to(values.clone()).requires_grad_() for values in (image, radius)]
        found = render(given[0], given[1], left_right=True)
        loss = (found.render * 2).sum() + found.left.square().sum()
        return [*torch.autograd.grad(loss, given)]

    agree(slopes, 1e-12)


def test_nor_does_a_lens(agree):
    image, depth = torch.rand(1, 3, 30, 40), 1500 + 1000 * torch.rand(1, 1, 30, 40)
    point = torch.tensor([0.0, 0.0, -2100.0])

    def made(to, *, tensors):
        foclen, fnum = (torch.tensor(50.0), torch.tensor(5.6)) if tensors else (50.0, 5.6)
        lens = DefocusLens(to(foclen) if tensors else foclen, to(fnum) if tensors else fnum)
        lens.refocus(2000.0)
        z = to(depth)
        return [
            lens.render_rgbd(to(image), z),
            *lens.render_rgbd_dp(to(image), z),
            *(lens.psf(to(point), ks=80, psf_type=kind) for kind in ("gaussian", "pillbox")),
            *lens.psf_dp(to(point), 80),
            lens.coc(z),
            lens.signed_radius(z),
            lens.dof(z),
        ]

    with torch.no_grad():
        agree(lambda to: made(to, tensors=False), 1e-6)
        agree(lambda to: made(to, tensors=True), 1e-6)


def test_nor_do_random_lenses(agree):
    image, depth = torch.rand(1, 3, 30, 40), 1000 + 3000 * torch.rand(1, 1, 30, 40)
    lenses = RandomDefocus(left_right=True)

    def taken(to, seeds):
        views, drawn = lenses(to(image), to(depth), seeds)
        return [*views.images, views.trust, drawn.signed_radius]

    with torch.no_grad():
        agree(lambda to: taken(to, [3]))
        agree(lambda to: taken(to, to(torch.tensor([3]))))


def test_nor_do_lights(agree):
    image, _ = scene()
    clipped = (image * 2).clamp(max=1)

    def work(to):
        lights = with_lights(to(clipped), 0.8, 4.0)
        assert isinstance(lights, Tensor)
        return [lights]

    with torch.no_grad():
        agree(work)


def test_nor_does_the_lens_of_a_pair(agree):
    image, disparity = torch.rand(3, 64, 64), torch.linspace(0, 1, 64)[:, None].repeat(1, 64)
    seen = render(image, 8 * (0.4 - disparity)).render

    def work(to):
        sharp = to(image)
        whole = Scale(sharp, to(disparity), to(seen)[None], clipped(sharp))
        residual = Residual(whole, render, exposure=True, infinity=0.0)
        point = Point(far=3.4, near=-5.1, across=0.5, growth=0.01)
        return [x for scale in (whole, whole.reduced(32)) for x in residual.of(point, scale)]

    with torch.no_grad():
        agree(work, 1e-5)


@pytest.mark.parametrize("kind", ["floor", "cards", "lights"])
def test_tiles_wait_for_nothing(device, kind, monkeypatch):
    image, radius = scene(kind)
    waited: list[int] = []
    tile = Region.tile

    def noted(self, index):
        with Launches(device.name) as counts:
            found = tile(self, index)
        waited.append(counts.waits)
        return found

    monkeypatch.setattr(Region, "tile", noted)
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


@pytest.mark.parametrize(
    "options",
    [
        {"left_right": True, "aperture": Aperture(5, 10.0)},
        {"cat_eye": CatEye(1.1, 0.5), "depth_repair": "off"},
    ],
    ids=lambda options: "-".join(options),
)
def test_a_batch_is_its_pictures(anywhere, options):
    # of other ranges of radius, one with highlights: no two plans are the same
    scenes = [scene(kind, (41, 52)) for kind in ("floor", "most", "lights")]
    radii = [radius * (0.3 + 0.3 * i) for i, (_, radius) in enumerate(scenes)]
    images = [image for image, _ in scenes]
    with torch.no_grad(), anywhere.known():
        each = [
            pictures(*map(anywhere.there, pair), **options)
            for pair in zip(images, radii, strict=True)
        ]
        batch = pictures(*(anywhere.there(torch.stack(x)) for x in (images, radii)), **options)
        for together, apart in zip(batch, zip(*each, strict=True), strict=True):
            if together is None:
                continue
            alone = torch.stack([anywhere.here(x) for x in apart if x is not None])
            torch.testing.assert_close(anywhere.here(together), alone, rtol=0, atol=anywhere.within)


def random_lenses(**options):
    return RandomDefocus(
        foclen=50.0,
        fnum=Distribution("loguniform", (2.8, 8.0)),
        sensor_width=12.0,
        depth_repair="off",
        **options,
    )


def depths_of(count, size):
    floor = torch.linspace(2000, 600, size[0])[:, None].repeat(1, size[1])
    floor[10:24, 8:30] = 440
    return torch.stack([floor + 40 * number for number in range(count)])


@pytest.mark.parametrize(
    "options",
    [
        {
            "left_right": True,
            "curvature": Distribution("uniform", (0.0, 0.8)),
            "squeeze": Distribution("uniform", (0.7, 1.4)),
            "spherical": Distribution("uniform", (-0.5, 0.5)),
            "crosstalk": Distribution("uniform", (0.0, 0.3)),
        },
        {"cat_eye_size": 1.2, "cat_eye_shift": Distribution("uniform", (0.3, 0.9))},
    ],
    ids=lambda options: "-".join(options),
)
def test_a_batch_of_random_lenses_is_its_pictures(anywhere, options):
    size = (41, 52)
    images, depth = torch.stack([scene("cards", size)[0]] * 3), depths_of(3, size)
    lenses = random_lenses(**options)

    def taken(numbers):
        views, _ = lenses(anywhere.there(images[numbers]), anywhere.there(depth[numbers]), numbers)
        return [anywhere.here(x) for x in (*views.images, views.trust)]

    with torch.no_grad(), anywhere.known():
        each = [torch.cat(x) for x in zip(*(taken([number]) for number in range(3)), strict=True)]
        together = taken([0, 1, 2])
    for batch, alone in zip(together, each, strict=True):
        torch.testing.assert_close(batch, alone, rtol=0, atol=anywhere.within)


def test_so_are_its_gradients(anywhere):
    size = (18, 24)
    images, depth = torch.stack([scene("cards", size)[0]] * 2), depths_of(2, size)
    values = {"curvature": 0.4, "squeeze": 1.2}
    learnt = {name: torch.tensor(value, requires_grad=True) for name, value in values.items()}
    lenses = random_lenses(blades=6, **learnt)

    def gradients(numbers):
        given = [anywhere.there(x[numbers].clone()).requires_grad_() for x in (images, depth)]
        views, _ = lenses(*given, numbers)
        loss = views.render.square().sum()
        image, radius, *of_lens = torch.autograd.grad(loss, [*given, *learnt.values()])
        return [anywhere.here(image), anywhere.here(radius), torch.stack(of_lens)[None]]

    with anywhere.known():
        each = [torch.cat(x) for x in zip(gradients([0]), gradients([1]), strict=True)]
        together = gradients([0, 1])
    each[-1] = each[-1].sum(0, keepdim=True)
    for batch, alone in zip(together, each, strict=True):
        torch.testing.assert_close(batch, alone, rtol=0, atol=1e-4 * float(alone.abs().max()))


def test_little_memory_makes_more_tiles_of_the_same_picture(agree, device, monkeypatch):
    image, radius = scene("cards")
    tiles: list[int] = []

    def work(to):
        views = render(to(image), to(radius))
        tiles.append(views.stats["tiles"])
        return [views.render]

    with torch.no_grad():
        for memory in (1 << 33, 1 << 21):
            monkeypatch.setattr(device_plan, "memory_of", lambda device, memory=memory: memory)
            agree(work)
    assert tiles[1] == 1 < tiles[3]


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
