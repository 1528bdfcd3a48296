"""Validation of arguments: numbers and tensors, named in errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import index
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.nn import Parameter

T = TypeVar("T")
# Most letters of a wrong value that an error shows.
_LETTERS = 60


def whole(name: str, value: Any, remedy: str, minimum: int = 1) -> int:
    """A whole number of at least so much; 3.0 is one."""
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
    """The value of a number, or of a tensor of one number, as a float."""
    dense(name, value)
    try:
        if isinstance(value, str | bytes | complex | bool):
            raise TypeError
        return float(value.detach() if isinstance(value, Tensor) else value)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} must be one number, got {described(value)}; {remedy}") from None


def positive(name: str, value: Any, remedy: str) -> float:
    """The value of a number above 0 and finite, as a float."""
    size = number(name, value, remedy)
    if not 0 < size < math.inf:
        raise ValueError(f"{name} must be positive and finite, got {size:g}; {remedy}")
    return size


def numbers(
    name: str,
    value: Any,
    dtype: torch.dtype,
    device: torch.device,
    remedy: str = "lengths are in mm, without a unit",
) -> Tensor:
    """A tensor of at least float32; numbers that are no tensor get the dtype and the device."""
    wide = dtype if dtype.itemsize >= 4 else torch.float32
    dense(name, value)
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


def dense(name: str, value: Any) -> None:
    """Refuse a tensor that does not hold its numbers one by one, or holds none."""
    if isinstance(value, Tensor) and (kind := _kind(value)):
        problem = f"must be a dense tensor, got a {kind} one"
        raise ValueError(f"{name} {problem}; like its to_dense, dequantize or to_padded_tensor")


def _kind(value: Tensor) -> str:
    """The layout of a tensor that is not dense; empty for a dense one."""
    if value.is_nested:
        return "nested"
    if value.layout != torch.strided:
        return str(value.layout).removeprefix("torch.").strip("_")
    if value.is_quantized:
        return "quantized"
    return "meta" if value.is_meta and type(value) in (Tensor, Parameter) else ""


def flag(name: str, value: Any) -> bool:
    """True or False."""
    if isinstance(value, bool):
        return value
    raise ValueError(f"{name} must be True or False, got {described(value)}; bool() makes it one")


def one_of(name: str, value: Any, choices: Sequence[str]) -> str:
    """One of the choices."""
    if isinstance(value, str) and value in choices:
        return value
    raise ValueError(f"{name} must be one of {', '.join(choices)}, got {described(value)}")


def pair(name: str, sides: tuple[T, T]) -> tuple[T, T]:
    """A width and a height."""
    try:
        width, height = sides
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be (width, height), got {described(sides)}; a square has both, too"
        ) from None
    return width, height


def device_named(named: torch.device | str | None) -> torch.device:
    """The device of that name; for None a CUDA device if there is one, else the CPU."""
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
    """A floating-point type."""
    if isinstance(dtype, torch.dtype) and dtype.is_floating_point:
        return dtype
    raise ValueError(f"dtype must be floating point, got {dtype!r}; use torch.float32")


def check_image(image: Any, *, alone: bool = False) -> None:
    """Refuse an image that is no batch [B, C, H, W] of floats of 16 bits or more.

    `alone`: whether one image [C, H, W] is accepted, too.
    """
    dense("image", image)
    floats = isinstance(image, Tensor) and image.is_floating_point() and image.dtype.itemsize > 1
    if not floats or image.dim() not in ((3, 4) if alone else (4,)):
        wanted = "[B, C, H, W] or [C, H, W]" if alone else "[B, C, H, W]"
        remedy = "decode integers to linear light first" if alone else "one image is image[None]"
        raise ValueError(
            f"image must be a tensor {wanted} of floats, got {described(image)}; {remedy}"
        )
    if not image.numel():
        raise ValueError(
            f"image must hold a pixel, got {list(image.shape)}; leave out what holds none"
        )


def depth_maps(image: Tensor, depth: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    """The depth [B, H, W] of a batch of images.

    `image`: [B, C, H, W]; `depth`: [B, 1, H, W] or [B, H, W].
    """
    check_image(image)
    count, _, height, width = image.shape
    depth = numbers("depth", depth, dtype, device)
    maps: Tensor = depth[:, 0] if depth.ndim == 4 and depth.shape[1] == 1 else depth
    if maps.shape != (count, height, width):
        is_one = depth.shape == (height, width)
        remedy = "one map is depth[None]" if is_one else "resample it by nearest neighbour"
        raise ValueError(
            f"depth must be [B, 1, H, W] or [B, H, W] with the image's B={count}, H={height}, "
            f"W={width}, got {list(depth.shape)}; {remedy}"
        )
    return maps


def described(value: Any) -> str:
    """A value as an error shows it: type and shape of what has them."""
    if hasattr(value, "shape") and hasattr(value, "dtype") and tuple(value.shape):
        kind = "" if isinstance(value, Tensor) else f"{type(value).__name__} of "
        return f"{kind}{value.dtype} {list(value.shape)}"
    shown = repr(value.item() if isinstance(value, Tensor) else value)
    return shown if len(shown) <= _LETTERS else f"{shown[:_LETTERS]}…"


def bad_depth(name: str, depth: Tensor, good: Tensor, wanted: str) -> ValueError:
    """The error for distances that are not as wanted."""
    bad = depth.detach()[~good].flatten()
    return ValueError(
        f"{name} must be {wanted}, got {float(bad[0])} in {bad.numel()} of {depth.numel()} values; "
        "fill or mask what is not known, inf is the sky"
    )


def broadcast(first: torch.Size, second: torch.Size) -> bool:
    """Whether tensors of these shapes can be combined by broadcasting."""
    pairs = zip(reversed(first), reversed(second), strict=False)
    return all(a == b or 1 in (a, b) for a, b in pairs)


def between(name: str, limits: Any, z: Tensor) -> Tensor:
    """Whether distances z lie between two others, in mm, both included."""
    wanted = f"{name} must be (nearest, farthest) in mm, got {described(limits)}; None is no range"
    if not (isinstance(limits, Sequence) and len(limits) == 2):
        raise ValueError(wanted)
    near, far = (number(name, end, "two distances in mm") for end in limits)
    if not 0 < near <= far:
        raise ValueError(wanted)
    return (z >= near) & (z <= far)
