"""Parts of pictures: windows of what a function makes, and the regions of a renderer."""

import torch

KINDS = ("render", "left", "right")


def put_together(renderer):
    (H, W), found = renderer.size, {}
    for part in renderer.tiles():
        for kind in (*KINDS, "trust"):
            pixels = getattr(part, kind)
            if pixels is not None:
                whole = found.setdefault(kind, torch.full((*pixels.shape[:-2], H, W), torch.nan))
                part.box.crop(whole).copy_(pixels)
    return found


def same(found, rendering):
    return all(torch.equal(found[kind], getattr(rendering, kind)) for kind in found)
