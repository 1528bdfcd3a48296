"""The renderer of a scene, which first repairs its depth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace

import torch

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import repair_depth
from defocus_core.renderer.compiled.alone import needs_no_repair
from defocus_core.renderer.compiled.carried import carries
from defocus_core.renderer.engine.frame import SharedFrame, darkened
from defocus_core.renderer.engine.plan import computed_in, content_of, frame_of
from defocus_core.renderer.engine.scene import InFocus, Scene, Surface
from defocus_core.renderer.engine.settings import STANDARD, Settings, quality_of
from defocus_core.renderer.engine.survey import border_range, surveyed
from defocus_core.renderer.layers.alpha import color_of, without_alpha
from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.threads import own_modes, recorded_for, refuse_second_derivatives
from defocus_core.tensors.views import ViewTensors, added, assemble

# Counts that are 0 for copied tiles.
_COMPUTED = (
    *("slice_tiles_done", "slice_tiles_blurred", "slice_tiles_reduced"),
    "tiles_with_hidden",
)


class Renderer:
    """A prepared scene; its tiles are computed when they are iterated over.

    Attributes:
        size: (height, width) in px.
        repair: The repair of the depth.
        frame: The data that all regions share.
        scene: The scene with repaired depth.
        in_focus: The same scene as a picture in focus, with its layers.
    """

    def __init__(self, scene: Scene, settings: Settings = STANDARD) -> None:
        """Repair the depth of a scene, and prepare its frame."""
        self._given, self._counts = scene, list[dict[str, int]]()
        if launches_cost(scene.tensors[0].device):  # its memory is planned for one tile at once
            settings = replace(settings, threads=1)
        self._settings = settings
        with self._modes():
            self._prepare(scene, settings)

    def _modes(self) -> AbstractContextManager[object]:
        """The torch modes to compute in; gradients are recorded if an input requires them."""
        modes = ExitStack()
        modes.enter_context(own_modes(self._given.tensors[0].device))
        modes.enter_context(recorded_for(*self._given.tensors, self._settings))
        return modes

    def _prepare(self, scene: Scene, settings: Settings) -> None:
        quality = quality_of(settings.quality)
        self.repair = DepthRepair()
        if isinstance(scene, Surface):
            scene, self.repair = repaired(scene, settings)
        self.in_focus = InFocus.from_scene(scene)
        (counted, signed_radius), layered = self.in_focus.surface.tensors[:2], self.in_focus.layers
        self.size, border = (signed_radius.shape[0], signed_radius.shape[1]), None
        if layered is not None:
            quality = quality.of_layers(layered.deepest)
            counted = color_of(counted)
            border = border_range(self.in_focus.reaching)
        survey = surveyed(counted, signed_radius, computed_in(counted, signed_radius))
        self.frame = frame_of(
            counted,
            signed_radius,
            settings,
            quality,
            content_of(survey, quality, layered=layered),
            layered=layered,
            border=border,
        )
        self.scene = scene

    @property
    def back(self) -> str:
        """The back that blurs and composites: ``compiled`` or ``torch``."""
        return "compiled" if carries(self.frame, self.in_focus) else "torch"

    def tiles(self, progress: Callable[[int, int], None] | None = None) -> Iterator[ViewTensors]:
        """Yield the views of each region, in rows from the top, each row from left to right.

        A region is computed when it is asked for. Images are [C, h, w], of the dtype of the scene,
        at least float32. `progress`: called with the number of tiles done and the number of all
        tiles.
        """
        self._counts.clear()
        dtype = torch.promote_types(self._given.tensors[0].dtype, torch.float32)
        # not around the loop: the caller, who takes the tiles, would get the modes, too
        with self._modes():
            parts = self._parts(progress)
        while True:
            with self._modes():
                part = next(parts, None)
                if part is None:
                    return
                self._counts.append(part.stats)
                part = part.to(dtype)
            yield part

    def _parts(self, progress: Callable[[int, int], None] | None) -> Iterator[ViewTensors]:
        if self.back == "compiled":
            from defocus_core.renderer.compiled.once import compile_once
            from defocus_core.renderer.compiled.picture import rendered

            compile_once()
            views = rendered(self.in_focus, self.frame)
            if progress:
                progress(1, 1)
            return iter([views])
        from defocus_core.renderer.engine.regions import rendered_regions

        parts = rendered_regions(self.frame, self.in_focus, progress)
        if self.in_focus.layers is not None and not self.in_focus.layers.with_alpha:
            parts = map(without_alpha, parts)
        cat_eye = self.frame.settings.cat_eye
        if cat_eye is None or not cat_eye.vignetting:
            return parts
        return (darkened(part, cat_eye, self.size) for part in parts)

    def picture(self, progress: Callable[[int, int], None] | None = None) -> ViewTensors:
        """The views of the whole picture, in the dtype of the scene."""
        with self._modes():
            dtype = self._given.tensors[0].dtype
            views = assemble([part.to(dtype) for part in self.tiles(progress)])
            for image in views.images:
                if image.requires_grad:
                    image.register_hook(refuse_second_derivatives)  # type: ignore[no-untyped-call]
            return views._replace(stats=_total(self.frame, [views.stats]))

    def with_tile(self, tile: int | None) -> Renderer:
        """A renderer of the same scene with tiles of `tile` px; this renderer if that is None."""
        if tile is None:
            return self
        return Renderer(self.scene, replace(self._settings, tile=tile, depth_repair="off"))

    @property
    def stats(self) -> dict[str, int]:
        """Counts of the work done and skipped in the regions computed so far."""
        return _total(self.frame, self._counts)


def _total(frame: SharedFrame, counts: list[dict[str, int]]) -> dict[str, int]:
    """The sums of the counts of all regions; the compiled back counts no slices."""
    if counts and not any("slice_tiles" in each for each in counts):
        return added(counts)
    return {"slices": len(frame.radii), **added([dict.fromkeys(_COMPUTED, 0), *counts])}


def repaired(surface: Surface, settings: Settings) -> tuple[Surface, DepthRepair]:
    """A surface with repaired radii, and the repair that was made."""
    if needs_no_repair(surface, settings):
        return surface, DepthRepair()
    radius, repair = repair_depth(
        surface.signed_radius,
        surface.image,
        settings.infinity,
        settings.threads,
        depth_repair=settings.depth_repair,
        edge_width=settings.edge_width,
        decided=settings.decided,
        matte=surface.matte,
    )
    return replace(surface, signed_radius=radius), repair
