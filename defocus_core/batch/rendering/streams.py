"""Streams: the renderers of a job, one for each group of colours and for each direction.

What lies behind each other is known of layers, as of a deep picture or an element and its plate.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from defocus_core.batch.depth.focusing import radius_at_infinity, radius_map
from defocus_core.batch.elements.layers import layered
from defocus_core.batch.elements.plate import layers_of
from defocus_core.batch.look.lamps import lit
from defocus_core.batch.look.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.batch.rendering.colors_apart import (
    Colors,
    of_colors,
    renderings,
    turned_layer,
    turned_layers,
    with_offset,
)
from defocus_core.batch.rendering.memory_budget import holds_cells, room_on
from defocus_core.batch.rendering.outcome import Loaded, Outcome
from defocus_core.batch.sources import chosen, layer_windows, lone_window, plus, transposed, windows
from defocus_core.io.arrays import bands, times
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.renderer.engine.settings import Settings
    from defocus_core.renderer.engine.shared_fill import SharedFill
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
    from defocus_core.renderer.inpainting.known_layer import Behind
    from defocus_core.renderer.layers.stacked_samples import Layered
    from defocus_core.renderer.stream import Stream
    from defocus_core.tensors.source import Pixels
    from defocus_core.tensors.views import Views


class Streams:
    """The renderers of a job.

    Attributes:
        outcome: the job, and what is known of it so far.
        lights: number of clipped lights that were made brighter; None if this is not asked for.
    """

    def __init__(
        self, loaded: Loaded, radius: Any, outcome: Outcome, seen: HiddenLayer | None = None
    ) -> None:
        """Keep what they share; nothing is read yet.

        Args:
            loaded: the decoded inputs.
            radius: signed CoC radius in px, [H, W].
            outcome: the job, and what is known of it so far.
            seen: what other frames have seen of what is hidden.
        """
        self._loaded, self._radius, self._seen = loaded, radius, seen
        self.outcome = outcome
        self.lights: int | None = None
        self._fills: dict[bool, SharedFill | None] = {}

    @property
    def words(self) -> str:
        """What became of clipped lights, for people; empty if nothing was asked for."""
        return "" if self.lights is None else f"{counted(self.lights, 'clipped light')} brightened"

    def of(self, colors: Colors | None = None) -> Stream:
        """The renderer of some channels, which works region by region; of all without any."""
        from defocus_core.renderer.stream import Stream

        colors = colors or self._every
        settings = self._settings(colors)
        if self._layers is not None:
            layers, repair = self._layers
            layers = layers._replace(colors=chosen(layers.colors, self._light_of(colors)))
            layers = with_offset(layers, self._longer * colors.offset)
            layers = turned_layers(layers) if colors.turned else layers
            stream = Stream(layers.picture(alpha=True), layers.nearest(), settings, layered=layers)
            stream.repair = stream.repair if repair is None else repair
            return stream
        image, px = chosen(self._image, colors.channels), self._longer * colors.offset
        radii, repair = self._repaired
        radii = plus(radii, px)
        behind = of_colors(self._hidden, colors.channels, px, image)
        if colors.turned:
            image, radii = transposed(image), transposed(radii)
            behind = behind and turned_layer(behind)
        fill = self._fill(colors.turned)
        return Stream(
            image,
            radii,
            settings,
            behind,
            repair=repair,
            fill=None if fill is None else fill.of(colors.channels, px),
            hold=self._holds,
        )

    def _fill(self, turned: bool) -> SharedFill | None:
        """What is continued for all colours together; None of one rendering."""
        from defocus_core.renderer.engine.picture import shared_fill

        if turned not in self._fills:
            colors = [c for c in renderings(self._loaded, self.outcome) if c.turned == turned]
            fill, (radii, repair) = None, self._repaired
            if len(colors) > 1:
                image = transposed(self._image) if turned else self._image
                radii = transposed(radii) if turned else radii
                offsets = [self._longer * c.offset for c in colors]
                settings, keep = self._settings(colors[0]), self._holds
                fill = shared_fill(image, radii, settings, repair, offsets, keep=keep)
            self._fills[turned] = fill
        return self._fills[turned]

    def in_order(self, part: Views, colors: Colors) -> Views:
        """A rendered part with its channels in the order of those that were asked for.

        Of layers alpha is the last channel; of layers with a holdout the last light, too.
        """
        if self._layers is None:
            return part
        alpha, planes = len(self._loaded.color.light), self._light_of(colors)
        held_out = self._loaded.layers is not None and self._loaded.layers.held_out
        last = len(planes) - held_out
        order = [last if c == alpha else planes.index(c - (c > alpha)) for c in colors.channels]
        return part._replace(images=[image[order] for image in part.images])

    def _light_of(self, colors: Colors) -> list[int]:
        """The channels of the light of layers, which has no alpha but of a holdout, of colours."""
        alpha, layers = len(self._loaded.color.light), self._loaded.layers
        planes = [c - (c > alpha) for c in colors.channels if c != alpha]
        if layers is not None and layers.held_out and alpha in colors.channels:
            planes.append(len(layers.light[0]) - 1)
        return planes

    def _settings(self, colors: Colors) -> Settings:
        """The options of the renderer."""
        from defocus_core.renderer.engine.settings import Settings
        from defocus_core.sequences.shot_repair import repair_through

        outcome, loaded, job = self.outcome, self._loaded, self.outcome.job
        aperture, _ = aperture_in_pixels(outcome.lens, loaded.color.pixel_aspect, colors.color)
        infinity = None
        if not loaded.depth.is_radius:
            at_infinity = radius_at_infinity(outcome.lens, outcome.size)
            infinity = self._longer * (at_infinity + colors.offset)
        return Settings(
            aperture=aperture.transposed() if colors.turned else aperture,
            dual_pixel=dual_pixel_of(outcome.lens),
            cat_eye=cat_eye_of(outcome.lens, outcome.size),
            quality=outcome.quality,
            left_right=colors.turned or any(kind.halves for kind in job.outputs.rows),
            threads=job.machine.threads,
            tile=job.machine.tile,
            infinity=infinity,
            depth_repair=job.reading.depth_repair,
            edge_width=job.reading.edge_width,
            decided=outcome.decided and repair_through(outcome.decided, self._longer, infinity),
        )

    @property
    def _every(self) -> Colors:
        """All channels together."""
        return Colors(tuple(range(len(self._loaded.color.planes))))

    @cached_property
    def _holds(self) -> bool:
        """Whether there is room for what is derived from the whole picture."""
        room = room_on(self.outcome.device, self._loaded.holding.room_mb)
        return holds_cells(self._image.shape, room)

    @cached_property
    def _repaired(self) -> tuple[Pixels, DepthRepair]:
        """The radii, repaired once for all renderings, by the picture as it was given."""
        from defocus_core.depth.repair import repair_depth

        device, settings = self.outcome.device, self._settings(self._every)
        return repair_depth(
            lone_window(times(self._radius, self._longer), device),
            windows(self._loaded.color.planes, device),
            settings.infinity,
            settings.threads,
            depth_repair=settings.depth_repair,
            edge_width=settings.edge_width,
            decided=settings.decided,
            hold=self._holds,
        )

    @cached_property
    def _longer(self) -> float:
        """The longer half axis of the blur in px, in radii of the CoC."""
        return aperture_in_pixels(self.outcome.lens, self._loaded.color.pixel_aspect)[1]

    @cached_property
    def _image(self) -> Pixels:
        """The picture, with the light of its lamps."""
        color = self._loaded.color
        picture = windows(color.planes, self.outcome.device)
        (image,), self.lights = lit([picture], len(color.light), self.outcome.lens)
        return image

    @cached_property
    def _layers(self) -> tuple[Layered, DepthRepair | None] | None:
        """The scene if it is of layers, and the repair of its depth if that is repaired."""
        loaded, device, lens = self._loaded, self.outcome.device, self.outcome.lens
        if (layers := loaded.layers) is not None:
            keeping = loaded.holding.keeping
            radii = [radius_map(lens, d, keeping)[0] for d in layers.depths]
            lights: list[Pixels] = [windows(light, device) for light in layers.light]
            known = layered(lights, layers, [times(r, self._longer) for r in radii], device)
            if known.deepest == 1 and not known.open:
                return None
            lights, self.lights = lit(lights, layers.colors, lens)
            return known._replace(colors=layer_windows(lights)), None
        if loaded.plate is None:
            return None
        own, behind = (times(array, self._longer) for array in self._radius.arrays)
        pictures = (loaded.color, loaded.plate.color)
        lights = [windows((*c.light, *c.planes[len(c.channels) :]), device) for c in pictures]
        lights, self.lights = lit(lights, len(loaded.color.light), lens)
        settings = self._settings(self._every)
        return layers_of(lights, pictures, (own, behind), settings, device)

    @cached_property
    def _hidden(self) -> Behind | None:
        """The known hidden layer: that of files, and beside it what other frames have seen."""
        from defocus_core.renderer.inpainting.known_layer import Behind

        behind = None if self._loaded.behind is None else self._behind()
        if self._seen is None:
            return behind
        color, radius, mask = (each.to(self.outcome.device) for each in self._seen)
        radius = radius * self._longer
        if behind is None:
            return Behind(color, radius, mask)
        given = behind.mask[:]
        return Behind(
            behind.color[:].where(given, color),
            behind.signed_radius[:].where(given, radius),
            given | mask,
        )

    def _behind(self) -> Behind:
        """The hidden layer: it is unknown where depth is inf and colour 0."""
        import numpy as np

        from defocus_core.renderer.inpainting.known_layer import Behind

        loaded, device = self._loaded, self.outcome.device
        assert loaded.behind is not None
        color, depth = loaded.behind
        keeping = loaded.holding.keeping
        radius, _ = radius_map(self.outcome.lens, depth, keeping)
        known = keeping.new(depth.metres.shape, np.bool_)
        for rows in bands(depth.metres.shape):
            shown = np.logical_or.reduce([plane[rows] != 0 for plane in color.planes])
            known[rows] = np.isfinite(depth.metres[rows]) | shown
        return Behind(
            windows(color.planes, device),
            lone_window(times(radius, self._longer), device),
            lone_window(known, device),
        )
