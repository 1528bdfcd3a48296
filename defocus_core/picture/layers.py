"""Layers of a scene: light, coverage and depth of known surfaces behind each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.deep_layers import merge_samples, mix_samples
from defocus_core.io.exr.deep_samples import ALPHA, DEPTH, Strip
from defocus_core.io.exr.windows import Window
from defocus_core.io.images.color import Color
from defocus_core.system.text import counted

_CUT_AT_ONCE = 1 << 16  # pixels


@dataclass(frozen=True)
class Layers:
    """The layers of a deep picture, nearest first."""

    # for each layer arrays [H, W] of premultiplied light: colours, then passes
    light: tuple[tuple[Any, ...], ...]
    alpha: tuple[Any, ...]  # for each layer [H, W]
    depths: tuple[Depth, ...]
    colors: int  # number of colours in `light`
    merged: int = 0  # number of pixels with more samples than layers
    # whether some layers only hide others; the alpha of the picture is then the last plane of
    # `light`
    held_out: bool = False
    pictures: tuple[Color, ...] = ()  # for each layer the colour if its depth is repaired
    front: int = 0  # number of layers of the picture in front of another one

    @property
    def words(self) -> str:
        """The numbers of layers and of merged samples, in words."""
        merged = f", more in {counted(self.merged, 'pixel')} merged" if self.merged else ""
        return f"deep, {counted(len(self.alpha), 'sample')} a pixel at most{merged}"

    @property
    def is_flat(self) -> bool:
        """Whether each pixel has one opaque sample, as in a flat picture."""
        count = sum((alpha > 0).astype(np.uint8) for alpha in self.alpha)
        return bool(np.all(count == 1) and np.all(reduce(np.maximum, self.alpha) >= 1))

    def stacked_over(self, plate: Layers) -> Layers:
        """These layers in front of those of a plate."""
        return replace(
            self,
            light=(*self.light, *plate.light),
            alpha=(*self.alpha, *plate.alpha),
            depths=(*self.depths, *plate.depths),
            merged=self.merged + plate.merged,
            front=len(self.alpha),
        )

    def cut(self) -> Layers:
        """These layers with the samples of two pictures sorted by depth."""
        if not self.front:
            return self
        shape, merged = self.alpha[0].shape, 0
        names = (*(str(k) for k in range(len(self.light[0]))), ALPHA)
        layers: list[dict[str, Any]] = []
        for rows in bands(shape, _CUT_AT_ONCE):
            strip = self._samples(rows, names)
            behind = strip.pixel[strip.rank >= self.front] if self.front else ()
            both = np.intersect1d(behind, strip.pixel[strip.rank < self.front])
            strip, count = merge_samples(mix_samples(strip, names, both), names)
            merged += count
            while len(layers) < max(1, strip.maximum):
                layers.append({name: np.zeros(shape, "float32") for name in (*names, DEPTH)})
            for number, layer in enumerate(layers):
                chosen = strip.rank == number
                for name, plane in layer.items():
                    plane[rows] = strip.dense(chosen, strip.values[name])
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

    def _samples(self, rows: slice, names: tuple[str, ...]) -> Strip:
        """The samples of some rows, by number of the light, alpha and depth."""
        window = Window(0, rows.start, self.alpha[0].shape[1] - 1, rows.stop - 1)
        columns = []
        every = zip(self.light, self.alpha, self.depths, strict=True)
        for number, (light, alpha, depth) in enumerate(every):
            planes = [plane[rows] for plane in (*light, alpha, depth.metres)]
            at = np.flatnonzero(planes[len(light)] > 0)
            rank = np.full(len(at), number)
            columns.append((at, rank, *(np.ravel(plane)[at] for plane in planes)))
        pixel, rank, *values = (np.concatenate(each) for each in zip(*columns, strict=True))
        return Strip(window, pixel, rank, dict(zip((*names, DEPTH), values, strict=True)))

    def hold_out(self, holdout: Layers, black: Any) -> Layers:
        """These layers with those of a holdout, which hide others and have no light."""
        shown = tuple((*light, a) for light, a in zip(self.light, self.alpha, strict=True))
        hiding = ((black,) * len(shown[0]),) * len(holdout.alpha)
        whole = replace(self, light=shown).stacked_over(replace(holdout, light=hiding))
        return replace(whole, held_out=True, front=self.front)


def flat_layer(color: Color, depth: Depth) -> Layers:
    """A flat picture as one layer."""
    light = (*color.light, *color.planes[len(color.channels) :])
    alpha, depth = coverage(color.planes[0].shape, color.alpha), replace(depth, empty=None)
    return Layers((light,), (alpha,), (depth,), len(color.light))


def coverage(shape: tuple[int, int], alpha: Any) -> Any:
    """The coverage of each pixel by a picture: its alpha clipped to 0 … 1, or 1 without one."""
    if alpha is None:
        return np.broadcast_to(np.float32(1), shape)
    return np.clip(np.asarray(alpha, np.float32), 0, 1)
