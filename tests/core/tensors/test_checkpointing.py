"""What a backward pass computes again: the same gradients, from far fewer tensors kept."""

import torch
from torch.autograd.graph import saved_tensors_hooks

from defocus_core import render
from defocus_core.renderer.engine import regions


def kept_and_gradients(image, radius):
    """Bytes that a forward pass keeps, and what the backward pass makes of them."""
    image, radius = image.clone().requires_grad_(), radius.clone().requires_grad_()
    kept: dict[int, int] = {}

    def keep(values):
        kept[values.untyped_storage().data_ptr()] = values.untyped_storage().nbytes()
        return values

    with saved_tensors_hooks(keep, lambda values: values):
        o = render(image, radius, left_right=True)
    assert o.left is not None
    weight = torch.rand(o.render.shape, generator=torch.Generator().manual_seed(2))
    (o.render * weight + o.left * weight.flip(-1)).sum().backward()
    return sum(kept.values()), image.grad, radius.grad


def test_a_backward_pass_keeps_little_and_finds_the_same(monkeypatch):
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(3, 200, 260, generator=generator)
    radius = torch.full((200, 260), 7.0) + torch.rand(200, 260, generator=generator)
    radius[60:140, 80:180] = -6.0
    kept, of_image, of_radius = kept_and_gradients(image, radius)
    monkeypatch.setattr(regions, "recomputed", lambda work: work)
    all_kept, image_too, radius_too = kept_and_gradients(image, radius)
    assert kept < all_kept / 10
    assert torch.equal(of_image, image_too)
    assert torch.equal(of_radius, radius_too)


def test_progress_ends_with_the_picture():
    image, radius = torch.rand(3, 40, 210, requires_grad=True), torch.full((40, 210), 3.0)
    told: list[tuple[int, int]] = []
    o = render(image, radius, progress=lambda *counts: told.append(counts))
    o.render.sum().backward()
    assert told == [(1, 2), (2, 2)]
