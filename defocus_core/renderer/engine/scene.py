"""A scene: a picture with one surface per pixel, or layers with coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.matting import EDGE, mixed_pixels
from defocus_core.renderer.engine.limits import BRIGHTEST
from defocus_core.renderer.inpainting.hidden_layers import hidden_layer
from defocus_core.renderer.layers.alpha import color_of
from defocus_core.renderer.layers.layer import HiddenLayer, KnownLayer
from defocus_core.renderer.layers.layer import layers_of as of_picture
from defocus_core.renderer.layers.samples import Layered
from defocus_core.tensors.validation import Scalar, backward_only, described

# Difference of a picture from a known layer, as a share of it, up to which it may be rounding.
_ROUNDING = 1e-3
_DECODE = "decode integers to linear light first"


@dataclass(frozen=True, eq=False)
class Surface:
    """A picture with one surface at each pixel."""

    image: Tensor  # [C, H, W], linear light, premultiplied if it has alpha
    signed_radius: Tensor  # [H, W] px, negative nearer than focus
    matte: Tensor | None = None  # [H, W], the coverage of a subject; None if it is not known

    def __post_init__(self) -> None:
        """Check shapes and types."""
        shape, size = tuple(self.image.shape), tuple(self.signed_radius.shape)
        if len(shape) != 3 or 0 in shape or shape[1:] != size:
            raise ValueError(
                f"image must be [C, H, W] and signed_radius [H, W], of a pixel at least, got "
                f"{shape} and {size}; one of a batch is image[0] and signed_radius[0, 0]"
            )
        for name in ("image", "signed_radius"):
            dtype = getattr(self, name).dtype
            if not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
                raise ValueError(f"{name} must be of floats of torch, got {dtype}; {_DECODE}")
        if self.matte is not None and tuple(self.matte.shape) != size:
            raise ValueError(
                f"matte must be of the size of the picture {size}, got {tuple(self.matte.shape)}; "
                "resample it"
            )

    @property
    def tensors(self) -> list[Tensor]:
        """All tensors of the surface."""
        return [x for x in (self.image, self.signed_radius, self.matte) if x is not None]


# What a lens sees: a surface, or layers of them.
Scene = Surface | Layered


def scene_of_layers(colors: Tensor, signed_radius: Tensor, coverage: Tensor) -> Scene:
    """The scene of layers with coverage; a `Surface` if a single layer covers all pixels.

    `colors`: [L, C, H, W], linear light, premultiplied by coverage; `signed_radius`: [L, H, W] px,
    unused where coverage is 0; `coverage`: [L, H, W] in [0, 1], the share of each pixel that the
    layer covers.
    """
    tensors = {"colors": colors, "signed_radius": signed_radius, "coverage": coverage}
    for name, tensor in tensors.items():
        backward_only(name, tensor)
        if not (isinstance(tensor, Tensor) and tensor.is_floating_point()):
            problem = f"{name} must be a tensor of floats, got {described(tensor)}"
            raise ValueError(f"{problem}; {_DECODE}")
    shape = tuple(colors.shape)
    each = (shape[0], *shape[2:]) if len(shape) == 4 else ()
    if not each or 0 in shape or {tuple(signed_radius.shape), tuple(coverage.shape)} != {each}:
        raise ValueError(
            f"layers must be colors [L, C, H, W] with signed_radius and coverage [L, H, W], "
            f"got {list(shape)}, {list(signed_radius.shape)} and {list(coverage.shape)}; "
            "one layer is colors[None]"
        )
    layered = Layered.from_layers(*tensors.values())
    if layered.deepest == 1 and not layered.open:
        return Surface(color_of(layered.picture()), layered.nearest())
    return layered


def with_hidden(surface: Surface, hidden: KnownLayer | None) -> Scene:
    """The scene of a surface and the known layer behind it.

    The radii of the surface are final and not repaired again. Returns the surface itself if the
    layer lies nowhere behind it.
    """
    if hidden is None:
        return surface
    check_hidden(hidden, tuple(surface.image.shape), tuple(surface.signed_radius.shape))
    color, radius, mask = (x.to(surface.image.device) for x in hidden)
    _check_known(color.detach(), radius.detach(), mask)
    color = torch.where(mask != 0, color.to(surface.image), 0)
    known = HiddenLayer(color, radius.to(surface.signed_radius), mask != 0)
    if not bool((known.mask & (known.signed_radius > surface.signed_radius)).any()):
        return surface
    return Layered.from_layers(*_split_surface(surface, known))._replace(with_alpha=False)


def element_layers(colors: Tensor, signed_radius: Tensor, coverage: Tensor) -> Layered:
    """The scene of an element, which is the first layer, and of the plate below it.

    The element is continued behind its own nearer parts. `colors`: [L, C, H, W], premultiplied;
    `signed_radius`, `coverage`: [L, H, W].
    """
    light, radius, cover = colors[0], signed_radius[0], coverage[0]
    there = cover > 0
    if not bool(there.any()):
        return Layered.from_layers(colors, signed_radius, coverage)
    nearest = torch.where(there, radius, radius[there].amin())  # from which nothing goes on
    found = hidden_layer(light / torch.where(there, cover, 1.0), nearest)
    if found is not None:
        behind = (found.mask & (cover == 1)).to(cover)
        layers = [(light, radius, cover), (found.color, found.signed_radius, behind)]
        rest = zip(colors[1:], signed_radius[1:], coverage[1:], strict=True)
        colors, signed_radius, coverage = _stacked([*layers, *rest])
    return Layered.from_layers(colors, signed_radius, coverage)


def _split_surface(surface: Surface, hidden: HiddenLayer) -> tuple[Tensor, Tensor, Tensor]:
    """Colours, radii and coverage of three layers: surface, known layer, and a nearer surface.

    The third layer holds the nearer surface of each mixed pixel that has the depth of the farther
    one. A mixed pixel that has the depth of the nearer surface belongs to it entirely where the
    surface behind is known.
    """
    (image, visible), (color, radius, known) = (surface.image, surface.signed_radius), hidden
    behind, whole = known & (radius > visible), torch.ones_like(visible).detach()
    wide = image.to(torch.promote_types(image.dtype, visible.dtype))
    own, *others = of_picture(wide, visible, mixed_pixels(wide, visible, matte=surface.matte))
    if not others:
        layers = [(image, visible, whole), (color, radius, behind.to(visible))]
        return _stacked(layers)
    nearer, cover = others[0], torch.where(known, 1.0, own.coverage[0])
    same = known & ((radius - visible).detach().abs() <= EDGE)
    bare = same & ((image - color).detach().abs() <= _ROUNDING * color.detach().abs()).all(0)
    share = _share(image - color, nearer.color - color).where(same, nearer.coverage[0])
    share = torch.where(bare | (nearer.coverage[0] == 0), 0.0, share)
    is_mixed, is_open = share > 0, cover < 1
    rest = image - (1 - share) * color
    same = same & (rest >= 0).all(0)  # else the known layer is lit differently
    shown = torch.where(is_mixed, torch.where(same, color, own.color), image)
    return _stacked(
        [
            (torch.where(is_open, own.color * cover, shown), visible, cover),
            (
                torch.where(is_open, nearer.color, color),
                torch.where(is_open, nearer.signed_radius, radius),
                (behind | is_open).to(visible),
            ),
            (torch.where(same, rest, nearer.color * share), nearer.signed_radius, share),
        ]
    )


def _share(mixed: Tensor, whole: Tensor) -> Tensor:
    """The factor [H, W] in [0, 1] by which `whole` [C, H, W] fits `mixed` by least squares."""
    square = whole.square().sum(0)
    return ((mixed * whole).sum(0) / torch.where(square > 0, square, 1.0)).clamp(0, 1)


def _stacked(layers: Sequence[tuple[Tensor, Tensor, Tensor]]) -> tuple[Tensor, Tensor, Tensor]:
    """Colours, radii and coverage of layers, each [L, ...] with the type of the first layer."""
    every = zip(*layers, strict=True)
    colors, radii, coverage = (torch.stack([x.to(own[0]) for x in own]) for own in every)
    return colors, radii, coverage


def in_colors(scene: Scene, channels: Sequence[int], px: Scalar) -> Scene:
    """A scene with only some channels of its colours, and with `px` added to its radii."""
    if isinstance(scene, Surface):
        image = _chosen(scene.image, channels)
        return replace(scene, image=image, signed_radius=_plus(scene.signed_radius, px))
    layers = scene._replace(colors=_chosen(scene.colors, channels))
    radii = _plus(scene.signed_radius, px)
    return layers if radii is scene.signed_radius else layers.with_radii(radii)


class InFocus(NamedTuple):
    """A scene as it is read by regions: the picture in focus, and the layers if there are any."""

    surface: Surface  # of layers, the picture with alpha and the nearest radii
    layers: Layered | None  # None for a single surface
    reaching: Tensor  # [H, W] px, of each pixel the radius of the widest blur

    @classmethod
    def from_scene(cls, scene: Scene) -> InFocus:
        """The picture in focus and the layers of a scene."""
        if isinstance(scene, Surface):
            return cls(scene, None, scene.signed_radius)
        surface = Surface(scene.picture(), scene.nearest())
        return cls(surface, scene, scene.most_blurred())


def _chosen(picture: Tensor, channels: Sequence[int]) -> Tensor:
    """Channels of a picture [..., C, H, W]; the picture itself if all are wanted."""
    some = list(channels)
    return picture if len(some) == picture.shape[-3] else picture[..., some, :, :]


def _plus(radii: Tensor, px: Scalar) -> Tensor:
    return radii if not isinstance(px, Tensor) and px == 0 else radii + px


def _check_known(color: Tensor, radius: Tensor, mask: Tensor) -> None:
    """Raise ValueError unless a known layer's light and radii are finite and in range."""
    where = mask.bool()
    for name, values in (("color", color[:, where]), ("signed_radius", radius[where])):
        if not bool((values.abs() <= BRIGHTEST).all()):
            raise ValueError(
                f"hidden.{name} must be finite and within ±{BRIGHTEST:g} where the mask is true; "
                "leave unknown pixels out"
            )


def check_hidden(hidden: object, shape: tuple[int, ...], size: tuple[int, ...]) -> None:
    """Raise ValueError unless a hidden layer fits pictures of `shape` and radii of `size`."""
    if not (
        isinstance(hidden, tuple)
        and len(hidden) == len(HiddenLayer._fields)
        and all(isinstance(getattr(x, "dtype", None), torch.dtype) for x in hidden)
    ):
        raise ValueError(
            f"hidden must be a HiddenLayer of three tensors, got {described(hidden)}; "
            "leave it out where nothing is known"
        )
    for name, value in zip(HiddenLayer._fields, hidden, strict=True):
        backward_only(f"hidden {name}", value)
    kinds = [x.dtype for x in hidden[:2]]
    if not all(kind.is_floating_point for kind in kinds):
        got = ", ".join(map(str, kinds))
        problem = f"hidden color and signed_radius must be of floats, got {got}"
        raise ValueError(f"{problem}; {_DECODE}")
    shapes, wanted = [tuple(x.shape) for x in hidden], [tuple(x) for x in (shape, size, size)]
    alone = [x[1:] for x in wanted] if len(shape) == 4 and shape[0] == 1 else wanted
    if shapes not in (wanted, alone):
        raise ValueError(
            f"hidden must be color, signed_radius and mask of shapes {wanted}, got {shapes}; "
            "resample them by nearest, and leave it out where nothing is known"
        )
