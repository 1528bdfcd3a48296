"""A scene: what is seen at each pixel, what is known to lie behind it, and what is continued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.renderer.layers.alpha import color_of
from defocus_core.renderer.layers.layer import HiddenLayer, KnownLayer
from defocus_core.renderer.layers.samples import Layered
from defocus_core.tensors.validation import Scalar, backward_only, described

# Greatest light of either sign: beyond it, sums over an aperture or a frame would overflow float32.
BRIGHTEST = 1e30
_DECODE = "decode integers to linear light first"


@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces in front of the lens: one at each pixel, or layers of them."""

    image: Tensor  # [C, H, W], linear light, premultiplied if it has alpha
    signed_radius: Tensor  # [H, W] px, negative nearer than focus
    hidden: KnownLayer | None = None  # the known layer behind the visible surface
    # The layers of which `image`, with alpha, is the `picture` in focus and `signed_radius` the
    # `nearest` radius; their views have alpha, too
    layered: Layered | None = None
    matte: Tensor | None = None  # [H, W], the coverage of a subject; None if it is not known
    # The repair by which the radii were made; None if they are to be repaired
    repair: DepthRepair | None = None

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
        if self.hidden is not None:
            check_hidden(self.hidden, shape, size)

    @classmethod
    def of_layers(cls, colors: Tensor, signed_radius: Tensor, coverage: Tensor) -> Scene:
        """The scene of layers with coverage; of one that covers all, a picture of its own.

        `colors`: [L, C, H, W], linear light, premultiplied by coverage; `signed_radius`: [L, H, W]
        px; unused where coverage is 0; `coverage`: [L, H, W] in [0, 1], the share of each pixel
        that the layer covers.
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
        layered = Layered.of(*tensors.values())
        if layered.deepest == 1 and not layered.open:
            return cls(color_of(layered.picture()), layered.nearest())
        return cls.of_layered(layered)

    @classmethod
    def of_layered(cls, layered: Layered, repair: DepthRepair | None = None) -> Scene:
        """The scene of layers that are looked through."""
        pixels, radius = layered.picture(), layered.nearest()
        return cls(pixels, radius, layered=layered, repair=repair)

    def as_layers(self) -> Scene:
        """The same as layers: the picture, and the known layer where it lies behind.

        Without these, if it lies nowhere behind. Where it is known all over, no pixel is taken
        apart: there is nothing to guess.
        """
        if self.hidden is None:
            return self
        color, radius, mask = self.hidden
        visible, complete = self.signed_radius, bool(mask.all())
        _check_known(color.detach(), radius.detach(), mask)
        behind = (mask.to(visible.device) != 0) & (radius.to(visible.device) > visible)
        layered = Layered.of(
            torch.stack([self.image, color.to(self.image)]),
            torch.stack([visible, radius.to(visible)]),
            torch.stack([torch.ones_like(visible), behind.to(visible)]).detach(),
        )
        if layered.deepest == 1:
            return replace(self, hidden=None)
        scene = Scene.of_layered(layered._replace(mixed=not complete), self.repair)
        return replace(scene, matte=self.matte)

    @property
    def tensors(self) -> list[Tensor]:
        """All that is in memory."""
        every = (
            *(self.image, self.signed_radius, self.matte),
            *(self.hidden or ()),
            *(self.layered or ()),
        )
        return [x for x in every if isinstance(x, Tensor)]

    def of_colors(self, channels: Sequence[int], px: Scalar) -> Scene:
        """The scene in some channels, with px added to its radii; of layers, of their colours."""
        if self.layered is not None:
            layers = self.layered._replace(colors=_chosen(self.layered.colors, channels))
            radii = _plus(layers.signed_radius, px)
            if radii is not layers.signed_radius:
                layers = Layered.of(layers.colors, radii, layers.coverage)
            return Scene.of_layered(layers, self.repair)
        hidden = self.hidden
        if hidden is not None:
            color, radius, mask = hidden
            hidden = _chosen(color, channels), _plus(radius, px), mask
        return replace(
            self,
            image=_chosen(self.image, channels),
            signed_radius=_plus(self.signed_radius, px),
            hidden=hidden,
        )


def _chosen(picture: Tensor, channels: Sequence[int]) -> Tensor:
    """Some channels of a picture [..., C, H, W]; itself of all of them."""
    some = list(channels)
    return picture if len(some) == picture.shape[-3] else picture[..., some, :, :]


def _plus(radii: Tensor, px: Scalar) -> Tensor:
    """Radii and some px; themselves without any."""
    return radii if not isinstance(px, Tensor) and px == 0 else radii + px


def _check_known(color: Tensor, radius: Tensor, mask: Tensor) -> None:
    """Refuse values of a known layer that are no light and no radius."""
    where = mask.bool()
    for name, values in (("color", color[:, where]), ("signed_radius", radius[where])):
        if not bool((values.abs() <= BRIGHTEST).all()):
            raise ValueError(
                f"hidden.{name} must be finite and within ±{BRIGHTEST:g} where the mask is true; "
                "leave unknown pixels out"
            )


def check_hidden(hidden: object, shape: tuple[int, ...], size: tuple[int, ...]) -> None:
    """Refuse what is no hidden layer of pictures of a shape and radii of a size.

    One picture of a batch may have a layer that is of none.
    """
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
