"""Checks of numbers and tensors that are given as arguments.

`name` is the name of the argument in error messages, `remedy` the advice at their end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import index
from typing import Any, TypeVar

from defocus_core.gone import remedy
from defocus_core.tensors.later import Tensor, torch

T = TypeVar("T")
Scalar = float | Tensor
# Most letters of a wrong value that an error shows.
_LETTERS = 60


def whole(name: str, value: Any, remedy: str, minimum: int = 1) -> int:
    """`value` as an int, checked to be at least `minimum`; 3.0 is accepted as 3."""
    number = int(value) if isinstance(value, float) and value.is_integer() else value
    try:
        if isinstance(value, bool):
            raise TypeError
        if (number := index(number)) >= minimum:
            return number
        wanted = f"at least {minimum}"
    except TypeError:
        wanted = f"a whole number, at least {minimum}"
    raise ValueError(f"{name} must be {wanted}, got {described(value)}; {remedy}")


def number(name: str, value: Any, remedy: str = "lengths are in mm") -> float:
    """`value`, a number or a one-element tensor, as a float."""
    try:
        if isinstance(value, str | bytes | complex | bool):
            raise TypeError
        return float(value.detach() if isinstance(value, Tensor) else value)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} must be one number, got {described(value)}; {remedy}") from None


def positive(name: str, value: Any, remedy: str) -> float:
    """`value`, a number or a one-element tensor, as a float, checked to be positive and finite."""
    size = number(name, value, remedy)
    if not 0 < size < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {size:g}; {remedy}")
    return size


def each_positive(name: str, value: Any, remedy: str) -> None:
    """Raise ValueError unless a number, or each number of a tensor [B], is positive and finite."""
    if not (isinstance(value, Tensor) and value.dim() == 1 and len(value) > 1):
        positive(name, value, remedy)
        return
    values = value.detach()
    if not bool(((values > 0) & values.isfinite()).all()):
        raise ValueError(f"{name} must be positive and finite, got {values.tolist()}; {remedy}")


def numbers(
    name: str,
    value: Any,
    dtype: torch.dtype,
    device: torch.device,
    remedy: str = "lengths are in mm, without a unit",
) -> Tensor:
    """A number or tensor as a floating-point tensor of at least 32 bits.

    A tensor stays on its device; numbers become a tensor on `device`, of `dtype` or float32.
    """
    wide = dtype if dtype.itemsize >= 4 else torch.float32
    try:
        tensor = (
            value if isinstance(value, Tensor) else torch.tensor(value, dtype=wide, device=device)
        )
        if tensor.is_complex() or tensor.dtype == torch.bool:
            raise TypeError
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(
            f"{name} must be a number or a tensor of them, got {described(value)}; {remedy}"
        ) from None
    if tensor.is_floating_point():
        return tensor if tensor.dtype.itemsize >= 4 else tensor.float()
    return tensor.to(wide)


def backward_only(name: str, value: Any) -> None:
    """Raise ValueError for meta tensors and tensors of torch.func, vmap or forward derivatives."""
    if not isinstance(value, Tensor):
        return
    if type(value) is torch.Tensor and value.is_meta:
        raise ValueError(
            f"{name} must hold values, got one on meta; what is rendered hangs on them"
        )
    what = "one within torch.func or vmap"
    if not torch._C._functorch.is_functorch_wrapped_tensor(value):
        what = "one with a forward derivative"
        if torch.autograd.forward_ad.unpack_dual(value).tangent is None:  # type: ignore[no-untyped-call]
            return
    remedy = "batches are its first dimension, gradients flow by backward and torch.autograd"
    raise ValueError(f"{name} must be a tensor of its own, got {what}; {remedy}")


def flag(name: str, value: Any) -> bool:
    """`value`, checked to be True or False."""
    if isinstance(value, bool):
        return value
    raise ValueError(f"{name} must be True or False, got {described(value)}; bool() makes it one")


def one_of(name: str, value: Any, choices: Sequence[str]) -> str:
    """`value`, checked to be one of the choices."""
    if isinstance(value, str) and value in choices:
        return value
    instead = remedy("value", value, name.replace("_", "-"))
    raise ValueError(
        f"{name} must be one of {', '.join(choices)}, got {described(value)}"
        + (f"; {instead}" if instead else "")
    )


def pair(name: str, sides: tuple[T, T]) -> tuple[T, T]:
    """`sides`, checked to be (width, height)."""
    try:
        width, height = sides
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be (width, height), got {described(sides)}; a square has both, too"
        ) from None
    return width, height


def device_named(named: torch.device | str | None) -> torch.device:
    """The torch device of a name; None for a CUDA device if there is one, else the CPU."""
    if named is None:
        named = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(named)
    except (RuntimeError, TypeError):
        raise ValueError(
            f"device must be one of torch's, got {named!r}; like cpu or cuda"
        ) from None
    if device.type != "cpu":
        count = getattr(getattr(torch, device.type, None), "device_count", int)()
        if (device.index or 0) >= count:
            problem = f"device must be one that is there, got {named!r}"
            raise ValueError(f"{problem}; torch finds {count} of that kind here, use cpu")
    return device


def floating(dtype: Any) -> torch.dtype:
    """`dtype`, checked to be a floating-point dtype of torch."""
    if isinstance(dtype, torch.dtype) and dtype.is_floating_point:
        return dtype
    raise ValueError(f"dtype must be floating point, got {dtype!r}; use torch.float32")


def check_image(image: Any, *, alone: bool = False) -> None:
    """Raise ValueError unless `image` is a batch [B, C, H, W] of floats of 16 bits or more.

    `alone`: whether a single image [C, H, W] is accepted, too.
    """
    is_tensor = isinstance(image, Tensor)
    floats = is_tensor and image.is_floating_point() and image.dtype.itemsize > 1
    if not floats or image.dim() not in ((3, 4) if alone else (4,)):
        wanted = "[B, C, H, W] or [C, H, W]" if alone else "[B, C, H, W]"
        remedy = "torch.from_numpy makes a tensor of an array"
        if is_tensor and not floats:
            remedy = "decode integers to linear light first, as read_color does"
        elif is_tensor:
            remedy = f"one image is image[{', '.join(['None'] * (4 - image.dim()))}]"
            remedy = remedy if image.dim() < 4 else "several batches are image.flatten(0, -4)"
        raise ValueError(
            f"image must be a tensor {wanted} of floats, got {described(image)}; {remedy}"
        )
    if 0 in image.shape[-3:]:
        raise ValueError(
            f"image must hold a pixel, got {list(image.shape)}; leave out what holds none"
        )
    backward_only("image", image)


def maps_of(name: str, maps: Tensor, image: Tensor) -> Tensor:
    """Depth or radius maps of images [B, C, H, W], reshaped to [B, H, W].

    `maps`: [B, 1, H, W] or [B, H, W]; for a single image also [H, W].
    """
    backward_only(name, maps)
    count, size = image.shape[0], tuple(image.shape[-2:])
    shapes = [(count, 1, *size), (count, *size)] + [size] * (count == 1)
    if tuple(maps.shape) in shapes:
        return maps.reshape(count, *size)
    remedy = f"resample it to {size[1]}x{size[0]} px by nearest neighbour"
    if maps.shape[-2:] == size:
        remedy = f"give one map for each of {count} pictures"
    elif tuple(image.shape[1:3]) in (maps.shape[-2:], maps.shape[-3:-1]):
        remedy = "channels come before rows and columns, image.movedim(-1, -3)"
    elif tuple(maps.shape[-3:]) == (*size, 1):
        remedy = f"rows and columns come last, {name}[..., 0]"
    raise ValueError(
        f"{name} must be [B, 1, H, W] or [B, H, W] of the image {list(image.shape)}, got "
        f"{list(maps.shape)}; {remedy}"
    )


def depth_maps(image: Tensor, depth: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    """The depth of images [B, C, H, W], as a tensor [B, H, W].

    `depth`: a tensor or numbers of a shape that `maps_of` accepts; numbers get `dtype` and
    `device`.
    """
    check_image(image)
    return maps_of("depth", numbers("depth", depth, dtype, device), image)


def described(value: Any) -> str:
    """A value as text for error messages: dtype and shape of an array, else its shortened repr."""
    if hasattr(value, "shape") and hasattr(value, "dtype") and tuple(value.shape):
        kind = "" if isinstance(value, Tensor) else f"{type(value).__name__} of "
        return f"{kind}{value.dtype} {list(value.shape)}"
    shown = repr(value.item() if isinstance(value, Tensor) else value)
    return shown if len(shown) <= _LETTERS else f"{shown[:_LETTERS]}…"


def bad_depth(name: str, depth: Tensor, good: Tensor, wanted: str) -> ValueError:
    """The error for depths that are not `good`, which shows the first of them and their number."""
    bad = depth.detach()[~good].flatten()
    return ValueError(
        f"{name} must be {wanted}, got {float(bad[0])} in {bad.numel()} of {depth.numel()} values; "
        "fill or mask what is not known, inf is the sky"
    )


def broadcast(first: torch.Size, second: torch.Size) -> bool:
    """Whether two shapes can be broadcast to one."""
    pairs = zip(reversed(first), reversed(second), strict=False)
    return all(a == b or 1 in (a, b) for a, b in pairs)


def distance_within(name: str, limits: Any, z: Tensor) -> Tensor:
    """Where distances z in mm lie within the limits (nearest, farthest) in mm, inclusive: bool."""
    wanted = f"{name} must be (nearest, farthest) in mm, got {described(limits)}; None is no range"
    if not (isinstance(limits, Sequence) and len(limits) == 2):
        raise ValueError(wanted)
    near, far = (number(name, end, "two distances in mm") for end in limits)
    if not 0 < near <= far:
        raise ValueError(wanted)
    return (z >= near) & (z <= far)
