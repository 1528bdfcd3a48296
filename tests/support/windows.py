"""Pictures read through windows, and put together from the regions of a renderer."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

KINDS = ("render", "left", "right")


@dataclass
class Windows:
    """A source that remembers how much of it was looked at at once."""

    whole: Tensor
    largest: int = 0
    looked_at: int = 0
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def shape(self):
        return tuple(self.whole.shape)

    @property
    def dtype(self):
        return self.whole.dtype

    def __getitem__(self, window):
        found = self.whole[window].clone()
        self.largest = max(self.largest, found[..., :, :].shape[-2])
        self.looked_at += found[0].numel() if found.dim() > 2 else found.numel()
        return found


def put_together(renderer, at_once=None):
    (H, W), found = renderer.size, {}
    for part in renderer.tiles(at_once):
        for kind in (*KINDS, "trust"):
            pixels = getattr(part, kind)
            if pixels is not None:
                whole = found.setdefault(kind, torch.full((*pixels.shape[:-2], H, W), torch.nan))
                part.box.of(whole).copy_(pixels)
    return found


def same(found, rendering):
    return all(torch.equal(found[kind], getattr(rendering, kind)) for kind in found)
