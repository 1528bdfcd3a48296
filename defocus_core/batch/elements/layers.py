"""Layers of a scene: light, coverage and depth of surfaces that are known behind each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from defocus_core.batch.elements.planes import coverage
from defocus_core.batch.sources import layer_windows, windows
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color_planes import Color
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.renderer.layers.stacked_samples import Layered
    from defocus_core.tensors.source import Pixels


@dataclass(frozen=True)
class Layers:
    """The layers of a deep picture, nearest first.

    Attributes:
        light: of each layer its arrays [H, W] of light, premultiplied: colours, then passes.
        alpha: of each layer [H, W].
        depths: of each layer.
        colors: number of colours in `light`.
        merged: number of pixels that had more samples than there are layers.
        held_out: whether some layers hide others and have no alpha: then that of the picture is the
            last plane of `light`.
    """

    light: tuple[tuple[Any, ...], ...]
    alpha: tuple[Any, ...]
    depths: tuple[Depth, ...]
    colors: int
    merged: int = 0
    held_out: bool = False

    @property
    def words(self) -> str:
        """How many layers there are, and what was merged, for people."""
        merged = f", more in {counted(self.merged, 'pixel')} merged" if self.merged else ""
        return f"deep, {counted(len(self.alpha), 'sample')} a pixel at most{merged}"

    def before(self, plate: Layers) -> Layers:
        """These layers and those of a plate behind them."""
        return replace(
            self,
            light=(*self.light, *plate.light),
            alpha=(*self.alpha, *plate.alpha),
            depths=(*self.depths, *plate.depths),
        )

    def held_out_by(self, holdout: Layers, black: Any) -> Layers:
        """These layers with others, which hide what is behind them and show nothing.

        Args:
            holdout: the others.
            black: an array of zeros.
        """
        shown = tuple((*light, a) for light, a in zip(self.light, self.alpha, strict=True))
        hiding = ((black,) * len(shown[0]),) * len(holdout.alpha)
        whole = replace(self, light=shown).before(replace(holdout, light=hiding))
        return replace(whole, held_out=True)


def flat_layer(color: Color, depth: Depth) -> Layers:
    """A picture that is not deep as one layer."""
    light = (*color.light, *color.planes[len(color.channels) :])
    alpha = coverage(color.planes[0].shape, color.alpha)
    return Layers((light,), (alpha,), (replace(depth, nothing=None),), len(color.light))


def layered(lights: Sequence[Pixels], layers: Layers, radii: Sequence[Any], device: str) -> Layered:
    """The layers as the renderer takes them.

    Args:
        lights: of each layer its light [C, H, W].
        layers: of a deep picture.
        radii: of each layer the signed radii [H, W] in px.
        device: cpu or cuda.
    """
    from defocus_core.renderer.layers.stacked_samples import Layered

    radius, alpha = windows(radii, device), windows(layers.alpha, device)
    return Layered.of(layer_windows(lights), radius, alpha)
