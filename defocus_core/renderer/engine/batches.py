"""Batches: pictures of one size that are computed at once, for each operation takes long to begin.

An accelerator computes as many as fit into its memory, a CPU small ones, which fit into its cache.
Pictures [C, B, H, W] have one plan: what any of them needs is computed for all, and is nothing in
the others. Pictures whose plans would change each other are batches of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import repaired_each
from defocus_core.depth.repair_options import RepairOptions
from defocus_core.renderer.engine.frame import Content
from defocus_core.renderer.engine.preparation import centre_parts, computed_in, content_of
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.engine.statistics import surveyed_each
from defocus_core.renderer.layers.quality import Quality, find
from defocus_core.tensors.device_plan import launches_cost, tile_pixels

# Pixels that a CPU computes at once; and bytes that one takes elsewhere with all layers of its
# tile, at least.
_PIXELS, _BYTES_EACH = 1 << 16, 2000


class PictureBatch(NamedTuple):
    """Pictures to compute at once."""

    numbers: list[int]  # their numbers among those given
    scene: Scene  # what they hold together, [C, B, H, W]; or one picture that is computed alone
    settings: Settings  # the options, with the lenses of all of them


def fit_together(pixels: Tensor, settings: Settings) -> bool:
    """Whether pictures [B, C, H, W] are computed in batches: where two of them fit, at least.

    A draft changes its size, and an exact number of slices spans the radii of each picture.
    """
    (count, _, H, W), options = pixels.shape, settings.repair
    by_scene = settings.num_layers is None and not find(settings.quality).half_size
    by_diagnosis = options in (RepairOptions(), RepairOptions(on=False))
    fits = _most_pixels(pixels.device) >= 2 * H * W
    return count > 1 and fits and by_scene and by_diagnosis


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
    if settings[0].repair.on:
        infinity = [one.infinity for one in settings]
        signed_radius, repairs = repaired_each(signed_radius, pixels, infinity)
    surveys = surveyed_each(pixels, signed_radius, computed_in(pixels, signed_radius))
    quality = find(settings[0].quality)
    contents = [
        content_of(survey, quality) for survey, repair in zip(surveys, repairs, strict=True)
    ]
    alike: dict[object, list[int]] = {}
    for number, (content, own) in enumerate(zip(contents, settings, strict=True)):
        key = content.double, *_pupil(own, quality)
        alone = content.highlights or content.minimum < 0 or _is_opaque(content, own, pixels)
        alike.setdefault((*key, number if alone else None), []).append(number)
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
