"""What is asked for is what is rendered, whatever modes of torch the caller is in."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import lru_cache

import pytest
import torch
from renderers import renderer_of
from synthetic_scenes import scenery

from defocus_core import DefocusLens, RandomDefocus, render


@contextmanager
def changed(change, value, usual):
    """A mode of torch that is set by a function, and is again what it was."""
    change(value)
    yield
    change(usual)


# "meta" stands for a GPU: what is made there cannot be taken for what is on the CPU
MODES = {
    "autocast": lambda: torch.autocast("cpu", torch.bfloat16),
    "a default device": lambda: torch.device("meta"),
    "a default dtype": lambda: changed(torch.set_default_dtype, torch.float64, torch.float32),
    "deterministic algorithms": lambda: changed(torch.use_deterministic_algorithms, True, False),
    "two threads of torch": lambda: changed(torch.set_num_threads, 2, 1),
}


@pytest.fixture(params=MODES)
def mode(request):
    return MODES[request.param]()


def pictures(seen):
    return torch.cat([seen.render, seen.left, seen.right, seen.trust])


@lru_cache
def two_tiles():
    image, radius = scenery("cards", 24, 200, 30.0)
    return image, radius, pictures(render(image, radius, left_right=True))


def test_the_callers_modes_do_not_change_a_picture(mode):
    image, radius, wanted = two_tiles()
    with mode:
        seen = pictures(render(image, radius, left_right=True, threads=2))
        parts = list(renderer_of(image, radius).tiles())
    assert torch.equal(seen, wanted)
    assert all(torch.equal(part.render, part.box.crop(wanted[:3])) for part in parts)


# backward sums in the caller's threads, and so in another order
@pytest.mark.parametrize("name", sorted(MODES.keys() - {"two threads of torch"}))
def test_the_callers_modes_do_not_change_a_gradient(name):
    image, radius = (x.requires_grad_() for x in scenery("cards", 40, 56, 8.0))
    wanted = torch.autograd.grad(render(image, radius).render.square().sum(), (image, radius))
    with MODES[name]():
        energy = render(image, radius).render.square().sum()
    with nullcontext() if name == "autocast" else MODES[name]():  # which torch asks for
        found = torch.autograd.grad(energy, (image, radius))
    assert all(map(torch.equal, found, wanted))


def test_products_are_not_rounded_as_the_caller_allows():
    product = torch.rand(64, 64, generator=torch.Generator().manual_seed(0))
    image, radius = (x.requires_grad_() for x in scenery("cards", 32, 64, 40.0))

    def seen():
        rendering = render(image, radius, left_right=True)
        energy = rendering.render.square().sum()
        return [pictures(rendering), *torch.autograd.grad(energy, (image, radius))]

    wanted, exactly = seen(), product @ product
    with changed(torch.set_float32_matmul_precision, "medium", "highest"):
        found, rounded = seen(), product @ product
    for a, b in zip(found, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5)
    if torch.equal(rounded, exactly):
        pytest.skip("not on this system: it rounds no products")


def test_the_callers_modes_do_not_change_a_lens(mode):
    image, depth = torch.rand(2, 3, 24, 32), torch.linspace(1e3, 5e3, 32).expand(2, 24, 32)
    lens = DefocusLens(50.0, 1.4, (36.0, 27.0), (32, 24))
    psf = lens.psf(torch.tensor([0.0, 0.0, 900.0]))
    random, _ = RandomDefocus()(image, depth, [1, 2])
    rendered = lens.render_rgbd(image, depth)
    with mode:
        assert torch.equal(lens.psf(torch.tensor([0.0, 0.0, 900.0], device="cpu")), psf)
        assert torch.equal(lens.render_rgbd(image, depth), rendered)
        again, lenses = RandomDefocus()(image, depth, [1, 2])
    assert torch.equal(again.render, random.render)
    assert (lenses.fnum.device.type, lenses.fnum.dtype) == ("cpu", torch.float64)


def test_torch_uses_one_thread_within_a_picture_and_the_callers_number_after_it():
    """Else the threads of small operations wait for each other, up to 18 times as long."""
    numbers = []
    image, radius = scenery("cards", 100, 120, 8.0)

    def progress(done, of):
        numbers.append(torch.get_num_threads())

    with MODES["two threads of torch"]():
        render(image, radius, progress=progress)
        assert torch.get_num_threads() == 2
        with ThreadPoolExecutor(3) as pool:
            list(pool.map(lambda _: render(image, radius, progress=progress), range(6)))
        after = ThreadPoolExecutor(1).submit(torch.get_num_threads).result()
    assert set(numbers) == {1}
    assert after == 2
