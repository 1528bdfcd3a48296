"""What makes no sense is refused at the door, in a line that names it and what would do."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from defocus_core import DefocusLens, Distribution, RandomDefocus, render

IMAGE, RADIUS = torch.rand(3, 12, 16), torch.linspace(-2, 3, 16).expand(12, 16)
DEPTH = torch.linspace(1e3, 4e3, 16).expand(1, 12, 16)


def lens(foclen=50.0, fnum=1.4, **options):
    return DefocusLens(foclen, fnum, (36.0, 27.0), (16, 12), **{"device": "cpu", **options})


def drawn(image=IMAGE[None], depth=DEPTH, seeds=(1,), **ranges):
    return RandomDefocus(**ranges)(image, depth, seeds)


WRONG_LATER: list[tuple[str, Any, str]] = [
    ("foclen", math.nan, "foclen must be positive and finite, got nan"),
    ("fnum", torch.tensor(-0.1), "fnum must be positive"),
    ("d_far", "20m", "d_far must be one number, got '20m'"),
    ("d_far", 0, "d_close must not be farther than d_far"),
    ("d_close", torch.ones(2), r"d_close must be one number, got torch.float32 \[2\]"),
    ("sensor_size", (36.0, 24.0), "pixels must be square, .* use a sensor height of 27 mm"),
    ("sensor_res", (0, 12), "horizontal sensor_res must be positive and finite, got 0"),
    ("obj_depth", None, "obj_depth must be one number, got None"),
    ("dtype", torch.int32, "dtype must be floating point, got torch.int32"),
    ("device", "gpu", "device must be one of torch's, got 'gpu'"),
]


@pytest.mark.parametrize(("name", "wrong", "said"), WRONG_LATER)
def test_what_makes_no_sense_any_more_is_refused_where_it_is_used(name, wrong, said):
    changed = lens()
    setattr(changed, name, wrong)
    uses = [changed.psf_map]
    if name not in ("obj_depth", "device"):  # which are asked for numbers alone
        uses.append(lambda: changed.render_rgbd(IMAGE[None], DEPTH))
    for use in uses:
        with pytest.raises(ValueError, match=said) as told:
            use()
        assert "; " in str(told.value), "what would do"


def test_limits_on_depth_may_be_tensors_and_have_gradients():
    limited = lens()
    limited.d_close = torch.tensor([1500.0], requires_grad=True)
    limited.signed_radius(DEPTH).sum().backward()
    assert float(limited.d_close.grad) > 0


def test_what_is_a_number_all_the_same_is_taken_for_it():
    points = torch.tensor([[0.0, 0.0, 900.0]])
    whole = lens().psf(points, ks=33)
    for ks in (33.0, np.int64(33), torch.tensor(33)):
        assert torch.equal(lens().psf(points, ks=ks), whole)
    assert torch.equal(lens().psf([[0, 0, 900]], ks=33), whole)
    depth = DEPTH.round()
    picture = lens().render_rgbd(IMAGE[None], depth)
    for same in (depth.int(), depth.numpy(), depth.to(torch.uint16), depth.tolist()):
        assert torch.equal(lens().render_rgbd(IMAGE[None], same), picture)
    narrow, usual = drawn(depth=depth.to(torch.uint16))[0], drawn(depth=depth)[0]
    assert torch.equal(narrow.render, usual.render)
    assert Distribution("choice", iter([0, 6])).values == (0, 6)  # type: ignore[arg-type]
    counts = Distribution("choice", tuple(np.array([6, 6])))
    assert drawn(blades=counts)[1].blades.tolist() == [6]


def test_a_parameter_of_one_element_is_a_number():
    parameters = [torch.nn.Parameter(torch.tensor([x])) for x in (50.0, 1.4, 2000.0)]
    one, usual = lens(*parameters[:2]), lens()
    one.refocus(parameters[2]), usual.refocus(2000.0)
    for of in (one, usual):
        assert of.coc(900.0).shape == of.hyperfocal(0.03).shape == of.dof(900.0, 0.03).shape == ()
        assert of.psf(torch.tensor([0.0, 0.0, 900.0])).shape == (64, 64)
    one.render_rgbd(IMAGE[None], DEPTH).square().sum().backward()
    assert all(x.grad is not None and bool((x.grad != 0).all()) for x in parameters)


def test_a_half_precision_lens_computes_in_float32():
    assert lens(dtype=torch.float16).coc(1000.0) == lens().coc(1000.0)


def test_pictures_may_be_changed_in_place():
    image = IMAGE.clone().requires_grad_()
    seen = render(image, RADIUS, left_right=True)
    seen.render.clamp_(0, 0.5).sum().backward()
    assert image.grad is not None


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("recorded", [False, True])
def test_each_picture_has_memory_of_its_own(count, recorded):
    image, radius = IMAGE.mT.contiguous().mT.expand(count, 3, 12, 16), RADIUS.expand(count, 12, 16)
    with torch.set_grad_enabled(recorded):
        seen = render(image, radius, left_right=True)
    for picture in (seen.render, seen.left, seen.right, seen.trust):
        assert picture.is_contiguous()
        assert picture.untyped_storage().nbytes() == picture.nbytes
