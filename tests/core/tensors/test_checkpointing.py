"""What a backward pass computes again: far fewer tensors are kept."""

import torch
from torch.autograd.graph import saved_tensors_hooks

from defocus_core import render


def test_little_is_kept_for_a_backward_pass():
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(3, 200, 260, generator=generator, requires_grad=True)
    radius = torch.full((200, 260), 7.0) + torch.rand(200, 260, generator=generator)
    radius[60:140, 80:180] = -6.0
    kept: dict[int, int] = {}

    def keep(values):
        kept[values.untyped_storage().data_ptr()] = values.untyped_storage().nbytes()
        return values

    with saved_tensors_hooks(keep, lambda values: values):
        render(image, radius.requires_grad_(), left_right=True)
    assert sum(kept.values()) < 60 * radius.nbytes, "it would be 570"
