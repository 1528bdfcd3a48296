"""The entry to the renderer: pictures and signed radii in, defocused pictures out.

The centre image is the mean of left and right, weighted by the areas of the halves. It is the same
whether or not left and right are asked for, unless photodiodes do not see exact halves: then torch
renders all three.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.axial_color import channel_groups
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.compiled.alone import views_alone
from defocus_core.renderer.engine.renderer import Renderer, repaired
from defocus_core.renderer.engine.scene import (
    Surface,
    check_hidden,
    in_colors,
    scene_of_layers,
    with_hidden,
)
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.layers.alpha import with_opaque_alpha
from defocus_core.renderer.layers.layer import HiddenLayer
from defocus_core.tensors.threads import graph_break, own_modes
from defocus_core.tensors.validation import Scalar, check_image, maps_of, numbers
from defocus_core.tensors.views import ViewTensors, batch, no_pictures, of_channels


@graph_break
def render(
    image: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture | None = None,
    quality: str = "standard",
    left_right: bool = False,
    num_layers: int | None = None,
    psf_ks: int | None = None,
    hidden: HiddenLayer | None = None,
    matte: Tensor | None = None,
    threads: int = 1,
    tile: int | None = None,
    infinity: float | Sequence[float] | Tensor | None = None,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    dual_pixel: DualPixel | None = None,
    cat_eye: CatEye | None = None,
    color_offsets: Sequence[Scalar] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ViewTensors:
    """Defocus images whose pixels have known CoC radii.

    I(x) is the mean over the aperture of what each lens point sees first (Haeberli & Akeley 1990);
    a pixel q with signed radius r is seen through lens point u at q + r u. Surfaces
    continue beyond the frame with the colours and radii of its edge; trust is the share of the
    aperture that saw the frame.

    If gradients are required, each region and its tiles are computed again in the backward pass.
    This takes 1.5 times as long, but only the memory of the pictures and of one region: 440 MB at
    960×540, 780 MB at 1080p.

    Args:
        image: [B, C, H, W] or [C, H, W], linear light, premultiplied if it has alpha.
        signed_radius: [B, 1, H, W], [B, H, W] or [H, W], px, negative nearer than focus.
        aperture: The pupil, a round one by default.
        quality: "standard", "high" or "reference": each has denser slices and takes longer.
        left_right: Whether to return the dual-pixel pair too.
        num_layers: Use exactly this many slices, evenly over the radii of each picture, instead
            of the slice radii of the quality.
        hidden: The surface behind the visible one, where it is known: of the shapes of image and
            radius. Elsewhere it is continued from farther surfaces.
        matte: [B, 1, H, W], [B, H, W] or [H, W] in [0, 1], the coverage of a subject, for example
            from a segmentation. The depth edge is put at its silhouette, and coverage there is
            not estimated.
        psf_ks: Greatest side of a kernel in px; None sizes kernels by the scene.
        threads: Tiles computed at once; torch itself uses one thread meanwhile.
        tile: Side of a tile in px, 16 at least; another side changes results in the last digits.
        infinity: Signed radius in px of infinitely far surfaces, by which edges that are soft in
            distance are found; None if all are soft in disparity. Give one for each picture if
            their lenses differ.
        depth_repair: "auto" repairs depth that is noisy, anti-aliased, soft at edges or quantised;
            "off" leaves it as it is.
        edge_width: Width in px of the widest soft edges of depth: wider ramps are surfaces. 0 means
            that all edges are hard, and no ramp becomes a step. None lets a diagnosis of the depth
            decide.
        dual_pixel: The photodiodes that see left and right; by default each sees a half of the
            aperture.
        cat_eye: The barrel that clips the aperture away from the middle of the frame. A highlight
            is clipped as at its own pixel; the blur of other pixels is interpolated between the
            corners of a region.
        color_offsets: For each channel the px to add to its signed radii, which is axial colour,
            see `color_offset`. Channels of different offsets are rendered separately; trust is the
            least of all.
        progress: Called with (tiles done, number of tiles) for each picture.

    Returns:
        Views in the shape and dtype of the image, their counts summed over the batch; half
        precision is computed in float32.

    Raises:
        ValueError: If shapes do not match, a radius or a pixel is not finite, an option is out of
            its range, or a CoC does not fit psf_ks.
    """
    settings = Settings(
        aperture=Aperture() if aperture is None else aperture,
        quality=quality,
        left_right=left_right,
        num_layers=num_layers,
        psf_ks=psf_ks,
        threads=threads,
        tile=tile,
        depth_repair=depth_repair,
        edge_width=edge_width,
        dual_pixel=DualPixel() if dual_pixel is None else dual_pixel,
        cat_eye=cat_eye,
    )
    pictures, radii = _batched(image, signed_radius)
    if not len(pictures):
        return no_pictures(pictures, 3 if left_right else 1)
    behind = _known_layers(hidden, pictures, radii)
    colors = channel_groups(color_offsets, pictures.shape[1])
    every = _settings_of_each(settings, infinity, len(pictures))
    mattes = [None] * len(pictures) if matte is None else _mattes(matte, pictures)
    views = [
        _rendered(Surface(one, radius, matte), known, own, colors, progress)
        for one, radius, known, matte, own in zip(
            pictures, radii, behind, mattes, every, strict=True
        )
    ]
    return batch(views) if image.dim() == 4 else views[0]


def _rendered(
    surface: Surface,
    hidden: HiddenLayer | None,
    settings: Settings,
    colors: list[tuple[list[int], Scalar]],
    progress: Callable[[int, int], None] | None,
) -> ViewTensors:
    """The views of one picture.

    `colors`: groups of channels, each with the px added to its radii; groups are rendered
    separately.
    """
    if len(colors) > 1 or hidden is not None:
        surface, _ = repaired(surface, settings)
        settings = replace(settings, depth_repair="off", edge_width=None)
    with own_modes(surface.image.device):
        scene = with_hidden(surface, hidden)
        scenes = [in_colors(scene, *each) for each in colors]
        if progress is None and len(scenes) == 1 and (alone := views_alone(scenes[0], settings)):
            return alone
    views = [Renderer(each, settings).picture(progress) for each in scenes]
    return views[0] if len(views) == 1 else of_channels(views, colors)


@graph_break
def render_layers(
    colors: Tensor,
    signed_radius: Tensor,
    coverage: Tensor,
    *,
    aperture: Aperture | None = None,
    quality: str = "standard",
    left_right: bool = False,
    num_layers: int | None = None,
    psf_ks: int | None = None,
    threads: int = 1,
    tile: int | None = None,
    infinity: float | None = None,
    depth_repair: str = "auto",
    progress: Callable[[int, int], None] | None = None,
) -> ViewTensors:
    """Defocus a scene whose surfaces are known behind each other, with their coverage.

    In each pixel, layers occlude each other by their radii: the layer of the smaller signed radius
    is the nearer one, and of equal radii the layer that comes first. Hidden surfaces are invented
    in two cases only: a single layer is continued behind its own edges as in `render`, within its
    silhouette; and if layers cover every pixel completely, gaps that they leave behind edges are
    filled.

    Args:
        colors: [L, C, H, W], linear light, premultiplied by coverage; any number of channels.
        signed_radius: [L, H, W] px, negative nearer than focus; unused where coverage is 0.
        coverage: [L, H, W] in [0, 1], the share of each pixel that the layer covers.
        aperture: As in `render`.
        quality: As in `render`.
        left_right: As in `render`.
        num_layers: As in `render`.
        psf_ks: As in `render`.
        threads: As in `render`.
        tile: As in `render`.
        infinity: As in `render`, for one layer without gaps.
        depth_repair: As in `render`, for one layer without gaps; other depth is taken as it is.
        progress: As in `render`.

    Returns:
        Views of [C + 1, H, W]: premultiplied colours, then alpha, the share of the aperture that
        saw a surface. One layer that covers all is `render` of it, and alpha is 1.

    Raises:
        ValueError: If shapes do not match, coverage is not in [0, 1], a colour or a radius is not
            finite where there is coverage, or an option is out of its range.
    """
    settings = Settings(
        aperture=Aperture() if aperture is None else aperture,
        quality=quality,
        left_right=left_right,
        num_layers=num_layers,
        psf_ks=psf_ks,
        threads=threads,
        tile=tile,
        infinity=infinity,
        depth_repair=depth_repair,
    )
    with own_modes(colors.device if isinstance(colors, Tensor) else None):
        scene = scene_of_layers(colors, signed_radius, coverage)
    views = Renderer(scene, settings).picture(progress).to(colors.dtype)
    return with_opaque_alpha(views) if isinstance(scene, Surface) else views


def _batched(image: Tensor, signed_radius: Tensor) -> tuple[Tensor, Tensor]:
    """The pixels [B, C, H, W] and the radii [B, H, W] of a single image or a batch."""
    check_image(image, alone=True)
    signed_radius = numbers("signed_radius", signed_radius, torch.float32, image.device, "in px")
    pixels = image if image.dim() == 4 else image[None]
    return pixels, maps_of("signed_radius", signed_radius, pixels).to(image.device)


def _settings_of_each(
    settings: Settings, infinity: float | Sequence[float] | Tensor | None, count: int
) -> list[Settings]:
    """The settings of each picture, with its own radius at infinity."""
    radii: Any = infinity.tolist() if isinstance(infinity, Tensor) else infinity
    if not isinstance(radii, list | tuple):
        return [replace(settings, infinity=radii)] * count
    if len(radii) != count:
        problem = f"infinity must be one radius, or one for each of {count} pictures"
        raise ValueError(f"{problem}, got {len(radii)}; None if not known")
    return [replace(settings, infinity=radius) for radius in radii]


def _mattes(matte: Tensor, pictures: Tensor) -> Tensor:
    """The coverages of subjects as [B, H, W], checked."""
    matte = numbers("matte", matte, torch.float32, pictures.device, "in [0, 1]")
    matte = maps_of("matte", matte, pictures).to(pictures.device)
    if not bool(((matte >= 0) & (matte <= 1)).all()):
        raise ValueError("matte must be in [0, 1], got other numbers; clamp it")
    return matte


def _known_layers(
    hidden: HiddenLayer | None, pictures: Tensor, radii: Tensor
) -> list[HiddenLayer | None]:
    """The known layer behind each picture."""
    if hidden is None:
        return [None] * len(pictures)
    check_hidden(hidden, pictures.shape, radii.shape)
    shapes = pictures.shape, radii.shape, radii.shape
    known = (x.reshape(of).to(pictures.device) for x, of in zip(hidden, shapes, strict=True))
    return [HiddenLayer(*each) for each in zip(*known, strict=True)]
