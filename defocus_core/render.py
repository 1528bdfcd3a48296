"""The renderer's door: pictures and signed radii in, defocused pictures out.

The centre image is the same whether or not left and right are asked for, and is their mean.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from defocus_core.engine.picture import Picture
from defocus_core.engine.region_schedule import assembled
from defocus_core.engine.settings import Settings
from defocus_core.images.views import Views, batch
from defocus_core.inpainting.hidden_layers import HiddenLayer
from defocus_core.inpainting.known_layer import Behind
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.runtime.torch_modes import own_modes
from defocus_core.runtime.validation import check_image, dense, described, numbers


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
    threads: int = 1,
    tile: int | None = None,
    infinity: float | None = None,
    depth_repair: str = "auto",
    dual_pixel: DualPixel | None = None,
    cat_eye: CatEye | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Views:
    """Defocus images whose pixels have known CoC radii.

    I(x) is the mean over the aperture of what each lens point sees first (Haeberli & Akeley 1990);
    a pixel q with signed radius r is seen through lens point u at q + r u. Outside the frame
    nothing is invented: each half of the aperture is divided by the share of it that saw the
    frame.

    Where gradients are wanted, each region and its tiles are computed again in the backward pass.
    This takes half as long again, but only the memory of the pictures and of one region: 440 MB at
    960×540, 780 MB at 1080p.

    Args:
        image: [B, C, H, W] or [C, H, W], linear light, premultiplied if it has alpha.
        signed_radius: [B, 1, H, W], [B, H, W] or [H, W], px, negative nearer than focus.
        aperture: The pupil, a round one by default.
        quality: "draft", "standard", "high" or "reference": spacing of slices, parts of the
            aperture. A draft is rendered at half of the size, its tiles and slices too, unless
            `num_layers` or `psf_ks` is given; pixels in focus get their detail back.
        left_right: Whether to return the dual-pixel pair too.
        num_layers: Use exactly this many slices, evenly over the radii of each picture, instead
            of the ladder of the quality.
        hidden: The surface behind the visible one where it is known, shaped as the image and the
            radius; elsewhere it is continued from farther surfaces.
        psf_ks: Greatest side of a kernel in px; None sizes kernels by the scene.
        threads: Tiles computed at once. With more than one, torch itself should use one thread
            (torch.set_num_threads(1)).
        tile: Side of a tile in px, or in cells of two px in a draft, 16 at least; another side
            changes results in the last digits.
        infinity: Signed radius in px of infinitely far surfaces: where depth is anti-aliased, it
            distinguishes averages of distance from averages of disparity. None takes all for
            averages of disparity.
        depth_repair: "auto" repairs depth that is noisy, anti-aliased, soft at edges or quantised;
            "off" leaves it as it is.
        dual_pixel: The photodiodes that left and right are of; by default each sees a half of the
            aperture.
        cat_eye: The barrel that clips the aperture off the middle of the frame. Lights are drawn
            as they see it, other pixels as a mean of what the corners of their region see.
        progress: Called with (tiles done, tiles in all) of each picture.

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
        infinity=infinity,
        depth_repair=depth_repair,
        dual_pixel=DualPixel() if dual_pixel is None else dual_pixel,
        cat_eye=cat_eye,
    )
    pictures, radii = _batched(image, signed_radius)
    behind = _hidden(hidden, pictures, radii)
    views = []
    for pixels, radius, known in zip(pictures, radii, behind, strict=True):
        with own_modes(pixels.device):
            picture = Picture(pixels, radius, settings, known)
            parts = picture.parts(progress=progress)
            views.append(assembled(picture.frame, pixels, parts))
    return batch(views) if image.dim() == 4 else views[0]


def _batched(image: Tensor, signed_radius: Tensor) -> tuple[Tensor, Tensor]:
    """[B, C, H, W] pixels and [B, H, W] radii."""
    check_image(image, alone=True)
    signed_radius = numbers("signed_radius", signed_radius, torch.float32, image.device, "in px")
    pixels = image.reshape(-1, *image.shape[-3:])
    count, size = pixels.shape[0], pixels.shape[-2:]
    shapes = {(count, 1, *size), (count, *size)} | ({tuple(size)} if count == 1 else set())
    if tuple(signed_radius.shape) not in shapes:
        raise ValueError(
            f"signed_radius must be [B, 1, H, W] or [B, H, W] of the image "
            f"{tuple(image.shape)}, got {tuple(signed_radius.shape)}; resample depth by nearest"
        )
    return pixels, signed_radius.to(image.device).reshape(count, *size)


def _hidden(hidden: HiddenLayer | None, pictures: Tensor, radii: Tensor) -> list[Behind | None]:
    """The known layer behind each picture."""
    if hidden is None:
        return [None] * len(pictures)
    tensors = isinstance(hidden, tuple) and all(isinstance(x, Tensor) for x in hidden)
    if not (tensors and len(hidden) == len(HiddenLayer._fields)):
        raise ValueError(
            f"hidden must be a HiddenLayer of three tensors, got {described(hidden)}; "
            "leave it out where nothing is known"
        )
    for name, value in zip(HiddenLayer._fields, hidden, strict=True):
        dense(f"hidden {name}", value)
    if not (hidden[0].is_floating_point() and hidden[1].is_floating_point()):
        kinds = ", ".join(str(x.dtype) for x in hidden[:2])
        raise ValueError(
            f"hidden color and signed_radius must be of floats, got {kinds}; "
            "decode integers to linear light first"
        )
    shapes = [tuple(x.shape) for x in hidden]
    sizes = [x.shape[1:] if len(pictures) == 1 else x.shape for x in (pictures, radii, radii)]
    batched = [pictures.shape, radii.shape, radii.shape]
    if shapes not in ([tuple(x) for x in sizes], [tuple(x) for x in batched]):
        raise ValueError(
            f"hidden must be color, signed_radius and mask of shapes {[*map(tuple, batched)]}, "
            f"got {shapes}; resample them by nearest"
        )
    known = (x.reshape(b).to(pictures.device) for x, b in zip(hidden, batched, strict=True))
    return [Behind(*one) for one in zip(*known, strict=True)]
