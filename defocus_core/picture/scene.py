"""Renderers of a job, one for each group of colours and for each direction.

What lies behind each other is known of layers, as of a deep picture or an element and its plate.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.io.arrays import bands, times
from defocus_core.io.images.color_planes import Color
from defocus_core.picture.layers import layered
from defocus_core.picture.memory_budget import holds_cells, room_on
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.radii import Radii
from defocus_core.picture.sources import layer_windows, lone_window, windows
from defocus_core.picture.steps.colors_apart import Colors, renderings
from defocus_core.picture.steps.lamps import lit
from defocus_core.picture.steps.plate import layers_of
from defocus_core.picture.take import Rendered

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.renderer.engine.scene import Scene
    from defocus_core.renderer.engine.settings import Settings
    from defocus_core.renderer.engine.shared_fill import SharedFill
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
    from defocus_core.renderer.inpainting.known_layer import KnownLayer
    from defocus_core.renderer.layers.stacked_samples import Layered
    from defocus_core.tensors.source import Pixels
    from defocus_core.tensors.views import Views


class Renderers:
    """The renderers of a job.

    Attributes:
        rendered: the picture, as far as it is known before rendering.
        lights: number of clipped lights that were made brighter; None if this is not asked for.
    """

    def __init__(
        self, rendered: Rendered, radius: Any = None, seen_behind: HiddenLayer | None = None
    ) -> None:
        """Keep what they share; nothing is read yet.

        `radius`: signed radii [H, W] in px of the picture, averaged with other frames; None for its
        own.
        """
        self.rendered, self._inputs, self._seen = rendered, rendered.inputs, seen_behind
        self._radii = (
            rendered.radii.picture if radius is None else rendered.radii.picture._replace(px=radius)
        )
        self.lights: int | None = None
        self._scenes: dict[bool, tuple[Scene, SharedFill | None]] = {}

    def of(self, colors: Colors | None = None) -> Renderer:
        """The renderer of some channels, which works region by region; of all without any."""
        from defocus_core.renderer.engine.renderer import Renderer

        colors = colors or self._every
        px, channels = self._longer * colors.offset, colors.channels
        (scene, fill), settings = self._scene(colors.turned), self._settings(colors)
        if self._layers is not None:
            return Renderer(scene.of_colors(self._light_of(colors), px), settings)
        return Renderer(scene.of_colors(channels, px, fill), settings, hold=self._holds)

    def _scene(self, turned: bool) -> tuple[Scene, SharedFill | None]:
        """The scene of all colours, and what is continued for all of them if they are apart."""
        from defocus_core.renderer.engine.renderer import shared_fill
        from defocus_core.renderer.engine.scene import Scene

        if turned not in self._scenes:
            if self._layers is not None:
                scene = Scene.of_layered(*self._layers)
            else:
                radii, repair = self._repaired
                scene = Scene(self._image, radii, self._hidden, repair=repair)
            scene, fill = scene.turned() if turned else scene, None
            colors = [c for c in renderings(self.rendered) if c.turned == turned]
            if len(colors) > 1 and self._layers is None:
                offsets = [self._longer * c.offset for c in colors]
                fill = shared_fill(scene, self._settings(colors[0]), offsets, keep=self._holds)
            self._scenes[turned] = scene, fill
        return self._scenes[turned]

    def in_order(self, part: Views, colors: Colors) -> Views:
        """A rendered part with its channels in the order of those that were asked for.

        Of layers alpha is the last channel; of layers with a holdout the last light, too.
        """
        if self._layers is None:
            return part
        alpha, planes = len(self._inputs.color.light), self._light_of(colors)
        held_out = self._inputs.layers is not None and self._inputs.layers.held_out
        last = len(planes) - held_out
        order = [last if c == alpha else planes.index(c - (c > alpha)) for c in colors.channels]
        return part._replace(images=[image[order] for image in part.images])

    def _light_of(self, colors: Colors) -> list[int]:
        """The channels of the light of layers, which has no alpha but of a holdout, of colours."""
        alpha, layers = len(self._inputs.color.light), self._inputs.layers
        planes = [c - (c > alpha) for c in colors.channels if c != alpha]
        if layers is not None and layers.held_out and alpha in colors.channels:
            planes.append(len(layers.light[0]) - 1)
        return planes

    def _settings(self, colors: Colors) -> Settings:
        """The options of the renderer."""
        from defocus_core.renderer.engine.settings import Settings
        from defocus_core.sequences.shot_repair import repair_through

        rendered, job = self.rendered, self.rendered.job
        aperture, _ = aperture_in_pixels(
            rendered.lens, self._inputs.color.pixel_aspect, colors.color
        )
        dual_pixel, infinity = dual_pixel_of(rendered.lens), self._radii.infinity
        if infinity is not None:
            infinity = self._longer * (infinity + colors.offset)
        return Settings(
            aperture=aperture.transposed() if colors.turned else aperture,
            dual_pixel=dual_pixel.transposed() if colors.turned else dual_pixel,
            cat_eye=cat_eye_of(rendered.lens, rendered.size),
            quality=rendered.quality,
            left_right=colors.turned or any(kind.halves for kind in job.outputs.rows),
            threads=job.machine.threads,
            tile=job.machine.tile,
            infinity=infinity,
            depth_repair=job.reading.depth_repair,
            edge_width=job.reading.edge_width,
            decided=rendered.decided and repair_through(rendered.decided, self._longer, infinity),
        )

    @property
    def _every(self) -> Colors:
        """All channels together."""
        return Colors(tuple(range(len(self._inputs.color.planes))))

    @cached_property
    def _holds(self) -> bool:
        """Whether there is room for what is derived from the whole picture."""
        room = room_on(self.rendered.device, self._inputs.holding.room_mb)
        color = self._inputs.color
        return holds_cells((len(color.planes), *color.shape[:2]), room)

    @cached_property
    def _repaired(self) -> tuple[Pixels, DepthRepair]:
        """The radii, repaired once for all renderings, by the picture as it was given."""
        return self._repair(self._radii, self._inputs.color, hold=self._holds)

    def _repair(
        self, radii: Radii, color: Color, *, hold: bool = False
    ) -> tuple[Pixels, DepthRepair]:
        """The radii of a picture, repaired as its settings say."""
        settings = self._settings(self._every)
        return radii.repaired(
            color,
            self.rendered.job.reading,
            device=self.rendered.device,
            threads=settings.threads,
            longer=self._longer,
            decided=settings.decided,
            hold=hold,
        )

    @cached_property
    def _longer(self) -> float:
        """The longer half axis of the blur in px, in radii of the CoC."""
        return aperture_in_pixels(self.rendered.lens, self._inputs.color.pixel_aspect)[1]

    @cached_property
    def _image(self) -> Pixels:
        """The picture, with the light of its lamps."""
        color = self._inputs.color
        picture = windows(color.planes, self.rendered.device)
        radii, _ = self._repaired
        (image,), self.lights = lit([picture], [radii], len(color.light), self.rendered.lens)
        return image

    @cached_property
    def _layers(self) -> tuple[Layered, DepthRepair | None] | None:
        """The scene if it is of layers, and the repair of its depth if that is repaired."""
        inputs, device, lens, radii = (
            self._inputs,
            self.rendered.device,
            self.rendered.lens,
            self.rendered.radii,
        )
        if (layers := inputs.layers) is not None:
            lights: list[Pixels] = [windows(light, device) for light in layers.light]
            px = [times(each.px, self._longer) for each in radii.layers]
            known = layered(lights, layers, px, device)
            if known.deepest == 1 and not known.open:
                return None
            blurred = [lone_window(each, device) for each in px]
            lights, self.lights = lit(lights, blurred, layers.colors, lens)
            return known._replace(colors=layer_windows(lights)), None
        if inputs.plate is None or radii.plate is None:
            return None
        pictures = (inputs.color, inputs.plate.color)
        lights = [windows((*c.light, *c.planes[len(c.channels) :]), device) for c in pictures]
        # each is repaired alone, as `render` would
        own_radii, repair = self._repair(radii.picture, inputs.color)
        plate, _ = self._repair(radii.plate, inputs.plate.color)
        repaired = (own_radii, plate)
        lights, self.lights = lit(lights, repaired, len(inputs.color.light), lens)
        return layers_of(lights, pictures, repaired, device), repair

    @cached_property
    def _hidden(self) -> KnownLayer | None:
        """The known hidden layer: that of files, and beside it what other frames have seen."""
        behind = None if self._inputs.hidden is None else self._behind()
        if self._seen is None:
            return behind
        color, radius, mask = (each.to(self.rendered.device) for each in self._seen)
        radius = radius * self._longer
        if behind is None:
            return color, radius, mask
        given = behind[2][:]
        return behind[0][:].where(given, color), behind[1][:].where(given, radius), given | mask

    def _behind(self) -> KnownLayer:
        """The hidden layer: it is unknown where depth is inf and colour 0."""
        device, radii = self.rendered.device, self.rendered.radii.hidden
        assert self._inputs.hidden is not None
        assert radii is not None
        color, depth = self._inputs.hidden
        known = self._inputs.holding.keeping.new(depth.metres.shape, np.bool_)
        for rows in bands(depth.metres.shape):
            shown = np.logical_or.reduce([plane[rows] != 0 for plane in color.planes])
            known[rows] = np.isfinite(depth.metres[rows]) | shown
        return (
            windows(color.planes, device),
            lone_window(times(radii.px, self._longer), device),
            lone_window(known, device),
        )
