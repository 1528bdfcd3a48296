"""The renderer of a scene, whose depth is repaired first.

Pictures of one size are computed at once, for each operation takes long to begin: an accelerator
computes as many as fit into its memory, a CPU small ones, which fit into its cache. Pictures
[C, B, H, W] have one plan: what any of them needs is computed for all, and is nothing in the
others. Pictures whose plans would change each other are batches of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import repair_depth, repaired_each
from defocus_core.renderer.engine.frame import Content, darkened
from defocus_core.renderer.engine.plan import (
    border_range,
    centre_parts,
    computed_in,
    content_of,
    frame_of,
    surveyed,
)
from defocus_core.renderer.engine.regions import assembled, rendered_regions, total
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import STANDARD, Settings
from defocus_core.renderer.layers.alpha import color_of, without_alpha
from defocus_core.renderer.layers.quality import Quality, find
from defocus_core.renderer.layers.slice_radii import plane_of
from defocus_core.tensors.device_plan import launches_cost, tile_pixels
from defocus_core.tensors.torch_modes import own_modes, recorded_for
from defocus_core.tensors.validation import whole
from defocus_core.tensors.views import Views

# Pixels that a CPU computes at once; and bytes that one takes elsewhere with all layers of its
# tile, at least.
_PIXELS, _BYTES_EACH = 1 << 18, 2000


class PictureBatch(NamedTuple):
    """Pictures to compute at once."""

    numbers: list[int]  # their numbers among those given
    scene: Scene  # what they hold together, [C, B, H, W]; or one picture that is computed alone
    settings: Settings  # the options, with the lenses of all of them


def fit_together(pixels: Tensor, settings: Settings) -> bool:
    """Whether pictures [B, C, H, W] are computed in batches: where two of them fit, at least.

    An exact number of slices spans the radii of each picture.
    """
    count, _, H, W = pixels.shape
    fits = _most_pixels(pixels.device) >= 2 * H * W
    return count > 1 and fits and settings.num_layers is None and settings.edge_width is None


def batches(
    pixels: Tensor, signed_radius: Tensor, settings: Sequence[Settings]
) -> list[PictureBatch]:
    """Pictures in batches, their depth repaired.

    `pixels`: [B, C, H, W] that `fit_together`; `signed_radius`: [B, H, W] px.
    """
    at_once = max(1, _most_pixels(pixels.device) // math.prod(pixels.shape[-2:]))
    if len(pixels) > at_once:
        parts = [slice(first, first + at_once) for first in range(0, len(pixels), at_once)]
        return [
            batch._replace(numbers=[part.start + number for number in batch.numbers])
            for part in parts
            for batch in batches(pixels[part], signed_radius[part], settings[part])
        ]
    pixels = pixels.movedim(0, 1).contiguous()
    repairs = [DepthRepair()] * len(signed_radius)
    if settings[0].depth_repair != "off":
        infinity = [one.infinity for one in settings]
        signed_radius, repairs = repaired_each(signed_radius, pixels, infinity)
    surveys = surveyed(pixels, signed_radius, computed_in(pixels, signed_radius))
    quality = find(settings[0].quality)
    contents = [
        content_of(survey, quality) for survey, repair in zip(surveys, repairs, strict=True)
    ]
    alike: dict[object, list[int]] = {}
    for number, (content, own) in enumerate(zip(contents, settings, strict=True)):
        key = content.double, content.edges, *_pupil(own, quality)
        alone = content.highlights or content.minimum < 0 or _is_opaque(content, own, pixels)
        plane = plane_of(*content.limits)
        alike.setdefault((*key, plane, number if alone else None), []).append(number)
    return [
        _batch(numbers, pixels, signed_radius, repairs, contents, settings)
        for numbers in alike.values()
    ]


def _batch(
    numbers: list[int],
    pixels: Tensor,
    signed_radius: Tensor,
    repairs: list[DepthRepair],
    contents: list[Content],
    settings: Sequence[Settings],
) -> PictureBatch:
    """Some pictures of [C, B, H, W]."""
    first = numbers[0]
    if len(numbers) == 1:
        alone = Scene(pixels[:, first], signed_radius[first], repair=repairs[first])
        return PictureBatch(numbers, alone, settings[first])
    if len(numbers) < len(signed_radius):
        index = torch.tensor(numbers).to(pixels.device)
        pixels, signed_radius = pixels.index_select(1, index), signed_radius.index_select(0, index)
    content = Content.of_batch([contents[number] for number in numbers])
    scene = Scene(pixels, signed_radius, repair=repairs[first], content=content)
    return PictureBatch(numbers, scene, Settings.of_batch([settings[n] for n in numbers]))


def _pupil(settings: Settings, quality: Quality) -> tuple[object, ...]:
    """What the pupils of pictures of a batch have in common."""
    aperture, cat_eye = settings.aperture, settings.cat_eye
    return (
        aperture.psf_type if aperture.image is None else aperture,
        cat_eye if cat_eye is None or cat_eye.vignetting else "clipped",
        settings.dual_pixel.halves,
        *aperture.parts(centre_parts(settings, quality)),
    )


def _is_opaque(content: Content, settings: Settings, pixels: Tensor) -> bool:
    """Whether an opaque middle of the pupil may hide the frame, see `SharedFrame.trace`."""
    opaque = float(settings.aperture.fixed.obstruction)
    return 4 * opaque * max(map(abs, content.limits)) >= min(pixels.shape[-2:])


def _most_pixels(device: torch.device) -> int:
    """The greatest number of pixels that are computed at once."""
    return tile_pixels(device, _BYTES_EACH) if launches_cost(device) else _PIXELS


class Renderer:
    """A scene as a lens sees it, prepared; its tiles are computed when they are taken.

    Attributes:
        size: (height, width) in px.
        repair: Repair of its depth.
        frame: The frame.
        scene: What is rendered, repaired.
        reaching: [H, W] px, the radii whose light reaches farthest.
    """

    def __init__(self, scene: Scene, settings: Settings = STANDARD) -> None:
        """Repair the depth, and prepare the frame."""
        self._given, self._counts = scene, list[dict[str, int]]()
        if launches_cost(scene.signed_radius.device):  # its memory is planned for one tile at once
            settings = replace(settings, threads=1)
        self._settings = settings
        with self._modes():
            self._prepare(scene, settings)

    def _modes(self) -> AbstractContextManager[object]:
        """The modes of torch to compute in: gradients are recorded if any is wanted."""
        modes = ExitStack()
        modes.enter_context(own_modes(self._given.image.device))
        modes.enter_context(recorded_for(*self._given.tensors, self._settings))
        return modes

    def _prepare(self, scene: Scene, settings: Settings) -> None:
        threads, quality = settings.threads, find(settings.quality)
        if scene.layered is None and scene.repair is None:
            scene = repaired_once(scene, settings)
        scene = scene.as_layers()
        layered = scene.layered
        self._drops_alpha = layered is not None and self._given.layered is None  # not asked for
        self.size = scene.signed_radius.shape[-2], scene.signed_radius.shape[-1]
        self.repair = scene.repair or DepthRepair()
        if layered is not None:
            quality = quality.of_layers(layered.deepest)
        image, signed_radius = scene.image, scene.signed_radius
        counted, self.reaching, border = image, signed_radius, None
        if layered is not None:
            counted = color_of(image)
            self.reaching = layered.most_blurred()
            border = border_range(self.reaching)
        content = scene.content
        if content is None:
            dtype = computed_in(counted, signed_radius)
            (survey,) = surveyed(counted, signed_radius, dtype, threads)
            content = content_of(survey, quality, layered=layered)
        self.frame = frame_of(
            counted,
            signed_radius,
            settings,
            quality,
            content,
            layered=layered,
            border=border,
        )
        self.scene = scene

    def tiles(
        self,
        at_once: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Views]:
        """Compute the tiles, and give them by region: in rows from the top, from left to right.

        Their images are [C, h, w], in the precision of the scene, float32 at least.

        `at_once`: greatest number of regions computed at once, which bounds memory; None for as
        many as threads.
        """
        at_once = None if at_once is None else whole("at_once", at_once, "None is as threads")
        self._counts.clear()
        dtype = torch.promote_types(self._given.image.dtype, torch.float32)
        # not around the loop: the caller, who takes the tiles, would get the modes, too
        with self._modes():
            parts = self._parts(at_once, progress)
        while True:
            with self._modes():
                part = next(parts, None)
                if part is None:
                    return
                self._counts.append(part.stats)
                part = part.to(dtype)
            yield part

    def _parts(
        self, at_once: int | None, progress: Callable[[int, int], None] | None
    ) -> Iterator[Views]:
        parts = rendered_regions(
            self.frame, self.scene, reaching=self.reaching, at_once=at_once, progress=progress
        )
        if self._drops_alpha:
            parts = map(without_alpha, parts)
        cat_eye = self.frame.settings.cat_eye
        if cat_eye is None or not cat_eye.vignetting:
            return parts
        return (darkened(part, cat_eye, self.size) for part in parts)

    def picture(self, progress: Callable[[int, int], None] | None = None) -> Views:
        """The views of the whole picture, in the precision of the scene."""
        image = self._given.image
        with self._modes():
            return assembled(self.frame, image, self.tiles(progress=progress))

    def with_tile(self, tile: int | None) -> Renderer:
        """The renderer of the same scene with tiles of another side in px; itself for None."""
        if tile is None:
            return self
        return Renderer(self.scene, replace(self._settings, tile=tile))

    @property
    def stats(self) -> dict[str, int]:
        """Counts of what was computed and what was skipped, of the regions that are done."""
        return total(self.frame, self._counts)


def repaired_once(scene: Scene, settings: Settings) -> Scene:
    """The scene with the radii by which all its colours are rendered."""
    radius, repair = repair_depth(
        scene.signed_radius,
        scene.image,
        settings.infinity,
        settings.threads,
        depth_repair=settings.depth_repair,
        edge_width=settings.edge_width,
        decided=settings.decided,
        matte=scene.matte,
    )
    return replace(scene, signed_radius=radius, repair=repair)
