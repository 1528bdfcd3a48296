"""Views of a picture, through the whole aperture and through its halves, with their trust.

One class holds the views of a tile, a region, a picture or a batch of pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.later import Tensor, torch


class ViewTensors(NamedTuple):
    """The views of a picture, of a rectangle of a picture, or of a batch of pictures.

    Attributes:
        images: The centre image, or the centre, left and right images, each [..., C, h, w].
        trust: [..., 1, h, w], the share of the aperture that sees content of the scene, visible or
            known to be hidden: 1 where nothing invented and nothing beyond the frame is seen.
        stats: Counts of work done and work skipped, by name.
        box: The rectangle of the frame that the views cover.
    """

    images: Sequence[Tensor]
    trust: Tensor
    stats: dict[str, int]
    box: Box

    @property
    def render(self) -> Tensor:
        """The defocused image, through the whole aperture."""
        return self.images[0]

    @property
    def left(self) -> Tensor | None:
        """The image through the lens half u.x < 0; None if only the centre was rendered."""
        return self.images[1] if len(self.images) > 1 else None

    @property
    def right(self) -> Tensor | None:
        """The image through the lens half u.x >= 0; None if only the centre was rendered."""
        return self.images[2] if len(self.images) > 1 else None

    def to(self, dtype: torch.dtype) -> ViewTensors:
        """The views converted to `dtype`; for float16, images are clamped to its finite range."""
        images = self.images
        if dtype == torch.float16:
            maximum = torch.finfo(dtype).max
            images = [image.clamp(-maximum, maximum) for image in images]
        return self._replace(
            images=[image.to(dtype) for image in images], trust=self.trust.to(dtype)
        )

    def crop(self, box: Box) -> ViewTensors:
        """The part of the views in `box`, a rectangle of the frame; its `stats` are empty."""
        window = box.seen_from(self.box)
        return ViewTensors(
            [window.crop(image) for image in self.images], window.crop(self.trust), {}, box
        )


def assemble(parts: Sequence[ViewTensors]) -> ViewTensors:
    """The views of a whole picture, joined from those of regions, in rows from left to right.

    Each image has memory of its own, so that keeping one does not keep the others.
    """
    rows = [
        [[*part.images, part.trust] for part in row]
        for _, row in groupby(parts, lambda part: part.box.top)
    ]
    joined = [[torch.cat(kind, -1) for kind in zip(*row, strict=True)] for row in rows]
    *images, trust = (torch.cat(kind, -2) for kind in zip(*joined, strict=True))
    spans = zip(parts[0].box.sides, parts[-1].box.sides, strict=True)
    box = Box.from_spans(*(Span(first.first, last.end) for first, last in spans))
    return ViewTensors(images, trust, added(part.stats for part in parts), box)


def batch(pictures: Sequence[ViewTensors]) -> ViewTensors:
    """The views of pictures of one size, stacked along a new first dimension."""

    def stack(tensors: Sequence[Tensor]) -> Tensor:
        return torch.stack(list(tensors)) if len(tensors) > 1 else tensors[0][None]

    images = [stack(kind) for kind in zip(*(one.images for one in pictures), strict=True)]
    trust = stack([one.trust for one in pictures])
    return ViewTensors(images, trust, added(one.stats for one in pictures), pictures[0].box)


def no_pictures(pixels: Tensor, kinds: int) -> ViewTensors:
    """The views of an empty batch `pixels` [0, C, H, W]; `kinds` is the number of images."""
    box = Box(0, 0, *pixels.shape[-2:])
    return ViewTensors([pixels.clone() for _ in range(kinds)], pixels[:, :1].clone(), {}, box)


def added(counts: Iterable[dict[str, int]]) -> dict[str, int]:
    """The counts of all dictionaries, summed by name."""
    total: dict[str, int] = {}
    for each in counts:
        total |= {name: total.get(name, 0) + count for name, count in each.items()}
    return total


def of_channels(
    colors: list[ViewTensors], offsets: list[tuple[list[int], float | Tensor]]
) -> ViewTensors:
    """The views of all channels, joined from renderings of some channels each.

    The trust is the least of the renderings.

    `offsets`: for each rendering, its channels and the px that were added to the radii.
    """
    order = torch.tensor([c for channels, _ in offsets for c in channels]).argsort().tolist()
    images = [
        torch.cat(channels)[order] for channels in zip(*(c.images for c in colors), strict=True)
    ]
    sharpest = min(
        range(len(colors)), key=lambda i: abs(float(torch.as_tensor(offsets[i][1]).detach()))
    )
    trust = torch.stack([c.trust for c in colors]).amin(0)
    return colors[sharpest]._replace(images=images, trust=trust)
