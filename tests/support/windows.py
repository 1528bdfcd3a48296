"""Parts of pictures: windows of what a function makes, and the regions of a renderer."""

import torch

from defocus_core.tensors.box import Box

KINDS = ("render", "left", "right")


def in_window(box, function, around, *pictures):
    """What a function makes of a box of pictures, given no more than so many px around it."""
    window = box.grown(around, Box(0, 0, *pictures[0].shape[-2:]))
    return box.seen_from(window).of(function(*map(window.of, pictures)))


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
