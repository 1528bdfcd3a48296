import pytest
import torch

from defocus_core import render_layers
from defocus_core.renderer.engine import region_layers
from defocus_core.renderer.layers import samples

_KINDS = ("opaque", "thin", "ordered")


def _layers(count, kind, side=8):
    generator = torch.Generator().manual_seed(7)
    radius = torch.rand(count, side, side, generator=generator) * 10 - 5
    if kind == "ordered":
        radius = torch.linspace(-5, 5, count)[:, None, None].expand_as(radius)
    cover = torch.rand(radius.shape, generator=generator)
    cover = (cover > 0.4).float() if kind == "opaque" else cover * 0.02
    color = torch.rand(count, 2, side, side, generator=generator) * cover[:, None]
    return color.requires_grad_(), radius, cover


@pytest.mark.parametrize("kind", _KINDS)
def test_many_layers_are_composited_as_each_alone(monkeypatch, kind):
    layers = _layers(60, kind)
    views = render_layers(*layers)
    (gradient,) = torch.autograd.grad(views.render.square().sum(), layers[0])
    monkeypatch.setattr(region_layers, "of_slices", lambda layers, radii: layers)
    monkeypatch.setattr(samples, "_FEW_SAMPLES", 1000)
    each = render_layers(*layers)
    (of_each,) = torch.autograd.grad(each.render.square().sum(), layers[0])
    torch.testing.assert_close(views.render, each.render, rtol=0, atol=1e-6)
    torch.testing.assert_close(gradient, of_each, rtol=1e-4, atol=1e-5)
