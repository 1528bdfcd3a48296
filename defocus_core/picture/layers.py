"""The layers of a scene: light, coverage and depth of surfaces that lie behind each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.deep_layers import merge_samples, mix_samples
from defocus_core.io.exr.deep_samples import ALPHA, DEPTH, DeepSamples
from defocus_core.io.exr.windows import Window
from defocus_core.io.images.color import Color
from defocus_core.system.text import counted


@dataclass(frozen=True)
class Layers:
    """The layers of a deep picture, or of an element over a plate, nearest first."""

    # for each layer its premultiplied light planes [H, W]: colours, then further blurred channels
    light: tuple[tuple[Any, ...], ...]
    alpha: tuple[Any, ...]  # for each layer [H, W]
    depths: tuple[Depth, ...]
    colors: int  # number of colours in `light`
    merged: int = 0  # number of pixels with more samples than layers
    # whether some layers only hide others; the alpha of the picture is then the last plane of
    # `light`
    held_out: bool = False
    pictures: tuple[Color, ...] = ()  # colour of each layer if its depth is repaired, else empty
    front: int = 0  # number of layers of the front picture, before they are sorted

    @property
    def words(self) -> str:
        """The number of layers, and of pixels where samples were merged, as text."""
        merged = f", more in {counted(self.merged, 'pixel')} merged" if self.merged else ""
        return f"deep, {counted(len(self.alpha), 'sample')} a pixel at most{merged}"

    @property
    def is_flat(self) -> bool:
        """Whether each pixel has exactly one sample, with alpha 1."""
        count = sum((alpha > 0).astype(np.uint8) for alpha in self.alpha)
        return bool(np.all(count == 1) and np.all(reduce(np.maximum, self.alpha) >= 1))

    def stacked_over(self, plate: Layers) -> Layers:
        """These layers followed by those of a plate, without sorting by depth."""
        return replace(
            self,
            light=(*self.light, *plate.light),
            alpha=(*self.alpha, *plate.alpha),
            depths=(*self.depths, *plate.depths),
            merged=self.merged + plate.merged,
            front=len(self.alpha),
        )

    def cut(self) -> Layers:
        """Layers sorted by depth in each pixel; needed after `stacked_over` joined two pictures."""
        if not self.front:
            return self
        names = (*(str(k) for k in range(len(self.light[0]))), ALPHA)
        samples = self._samples(names)
        behind = samples.pixel[samples.rank >= self.front]
        both = np.intersect1d(behind, samples.pixel[samples.rank < self.front])
        samples, merged = merge_samples(mix_samples(samples, names, both), names)
        layers = [
            {
                name: samples.dense(samples.rank == number, samples.values[name])
                for name in (*names, DEPTH)
            }
            for number in range(max(1, samples.maximum))
        ]
        far = np.float32(np.inf)
        for layer in layers:
            layer[DEPTH][~(layer[ALPHA] > 0)] = far
        return replace(
            self,
            light=tuple(tuple(layer[name] for name in names[:-1]) for layer in layers),
            alpha=tuple(layer[ALPHA] for layer in layers),
            depths=tuple(replace(self.depths[0], metres=layer[DEPTH]) for layer in layers),
            merged=self.merged + merged,
        )

    def _samples(self, names: tuple[str, ...]) -> DeepSamples:
        """The samples with alpha above 0, of all layers.

        `names` are those of the light planes, then alpha.
        """
        height, width = self.alpha[0].shape
        columns = []
        every = zip(self.light, self.alpha, self.depths, strict=True)
        for number, (light, alpha, depth) in enumerate(every):
            at = np.flatnonzero(alpha > 0)
            planes = (np.ravel(plane)[at] for plane in (*light, alpha, depth.metres))
            columns.append((at, np.full(len(at), number), *planes))
        pixel, rank, *values = (np.concatenate(each) for each in zip(*columns, strict=True))
        window = Window(0, 0, width - 1, height - 1)
        return DeepSamples(window, pixel, rank, dict(zip((*names, DEPTH), values, strict=True)))

    def hold_out(self, holdout: Layers, black: Any) -> Layers:
        """These layers and those of a holdout; the latter hide what is behind them, without light.

        `black` is a plane [H, W] of zeros. Alpha of the picture becomes the last plane of light.
        """
        shown = tuple((*light, a) for light, a in zip(self.light, self.alpha, strict=True))
        hiding = ((black,) * len(shown[0]),) * len(holdout.alpha)
        whole = replace(self, light=shown).stacked_over(replace(holdout, light=hiding))
        return replace(whole, held_out=True, front=self.front)


def flat_layer(color: Color, depth: Depth) -> Layers:
    """A picture with one sample per pixel, as a single layer."""
    light = (*color.light, *color.planes[len(color.channels) :])
    alpha, depth = coverage(color.planes[0].shape, color.alpha), replace(depth, empty=None)
    return Layers((light,), (alpha,), (depth,), len(color.light))


def coverage(shape: tuple[int, int], alpha: Any) -> Any:
    """The coverage of each pixel: alpha clipped to 0 to 1; or 1 everywhere if alpha is None."""
    if alpha is None:
        return np.broadcast_to(np.float32(1), shape)
    return np.clip(np.asarray(alpha, np.float32), 0, 1)
