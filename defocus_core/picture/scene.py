"""Scene: what a lens sees of a take, and the settings of its renderer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from defocus_core.io.arrays import times
from defocus_core.io.images.color import Color
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.radii import Radii
from defocus_core.picture.sources import layer_windows, map_windows, windows
from defocus_core.picture.steps.table import through
from defocus_core.picture.take import Take

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.renderer.engine.scene import Scene, SharedSurfaces
    from defocus_core.renderer.engine.settings import Settings
    from defocus_core.renderer.inpainting.hidden_layers import KnownLayer
    from defocus_core.tensors.source import Pixels


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of a scene: that of the picture, or one of each layer, nearest first."""

    take: Take
    # Of each surface that may be repaired the colour, whose edges are those of its depth
    colors: tuple[Color, ...]
    radii: tuple[Radii, ...]  # of each surface its radii, as the depth says
    # Of each surface [C, H, W], linear, premultiplied: of a picture with its alpha
    light: tuple[Pixels, ...]
    px: tuple[Pixels, ...]  # of each surface the radii [H, W] that it is rendered by
    coverage: Pixels | None = None  # [L, H, W] of layers; None of a picture
    repair: DepthRepair | None = None  # of the depth; None where nothing was looked for
    hidden: KnownLayer | None = None  # the known hidden layer
    matte: Pixels | None = None  # [H, W], the coverage of the subject; None if it is not known
    # Number of clipped lights that were made brighter; None if this is not asked for
    lamps: int | None = None

    @cached_property
    def longer(self) -> float:
        """The longer half axis of the blur in px, in radii of the CoC."""
        return longer_axis(self.take)

    @property
    def is_repaired(self) -> bool:
        """Whether its depth is to be repaired: that of deep pixels is what it is."""
        return bool(self.colors) and self.take.job.reading.depth_repair != "off"

    @property
    def knows_hidden(self) -> bool:
        """Whether files or other frames know what is hidden."""
        return self.take.inputs.hidden is not None or self.take.seen is not None

    @property
    def holds(self) -> bool:
        """Whether what is derived from the whole picture is kept."""
        return self.coverage is None and self.take.has_room

    def scene(self) -> Scene:
        """The scene of them."""
        from defocus_core.renderer.engine.scene import Scene
        from defocus_core.renderer.layers.samples import Layered

        if self.coverage is None:
            return Scene(
                self.light[0], self.px[0], self.hidden, repair=self.repair, matte=self.matte
            )
        stacked = layer_windows(self.light), layer_windows(self.px), self.coverage
        return Scene.of_layered(Layered.of(*stacked), self.repair)


class Pass(NamedTuple):
    """A rendering of a scene, or of some of its colours."""

    take: Take
    scene: Scene
    settings: Settings
    channels: tuple[int, ...]  # of the planes of the picture
    light: tuple[int, ...]  # the same of the scene, in its order
    px: float = 0.0  # added to the radii
    shared: SharedSurfaces | None = None  # the surfaces of all colours of the scene
    order: tuple[int, ...] = ()  # of the rendered channels; empty: as they are


def surfaces_of(take: Take) -> Surfaces:
    """The surfaces of a take, with all that happens to them."""
    color, device = take.inputs.color, take.device
    px = map_windows(times(take.blur.px, longer_axis(take)), device)
    light = windows(color.planes, device)
    return through("scene", Surfaces(take, (color,), (take.blur,), (light,), (px,)))


def passes_of(take: Take, scene: Scene) -> tuple[Pass, ...]:
    """All that is rendered of a scene; what says most of the picture comes last."""
    channels = tuple(range(len(take.inputs.color.planes)))
    return through("passes", (Pass(take, scene, settings_of(take), channels, channels),))


def settings_of(take: Take) -> Settings:
    """The options of the renderer."""
    from defocus_core.renderer.engine.settings import Settings

    job, infinity = take.job, take.blur.infinity
    return Settings(
        aperture=aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)[0],
        dual_pixel=dual_pixel_of(take.lens),
        cat_eye=cat_eye_of(take.lens, take.size),
        quality=job.machine.quality,
        left_right=any(kind.halves for kind in job.outputs.rows),
        threads=job.machine.threads,
        tile=job.machine.tile,
        infinity=None if infinity is None else longer_axis(take) * infinity,
        depth_repair=job.reading.depth_repair,
        edge_width=job.reading.edge_width,
    )


def longer_axis(take: Take) -> float:
    """The longer half axis of the blur in px, in radii of the CoC."""
    return aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)[1]
