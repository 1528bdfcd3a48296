"""Two pictures compared: files or arrays, as Python programs have them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from defocus_core.batch.lenses.quantities import QuantityError
from defocus_core.compare.comparison import compare_pictures
from defocus_core.compare.picture import DecodedPicture, read_picture
from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.compare.selection import CropRegion
from defocus_core.compare.thresholds import OVER, PRESETS, Rule, Rules, rule
from defocus_core.errors import UsageProblem

if TYPE_CHECKING:
    from os import PathLike

_CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}


def compare_images(
    a: str | PathLike[str] | ArrayLike,
    b: str | PathLike[str] | ArrayLike,
    *,
    fail: Sequence[str] = (),
    warn: Sequence[str] = (),
    over: float = OVER,
    region: tuple[int, int, int, int] | None = None,
    mask: str | PathLike[str] | None = None,
    flip: bool = False,
    metadata: bool = False,
    diagnose: bool = True,
    like: str | None = None,
) -> Comparison:
    """Say whether a picture is the same as another one, and if not, what happened to it.

    Without rules to fail all values must be equal. Another size or channel, and NaN or infinity on
    one side only, are never the same.

    Args:
        a: The reference: a file of colour or of a map; an array [H, W] or [H, W, C], linear; or a
            tensor [H, W], [C, H, W] or [1, C, H, W].
        b: What is judged, likewise.
        fail: Rules like ``psnr<45``: b fails if it meets one.
        warn: Rules that only give a warning.
        over: The difference that the metric ``share`` counts pixels beyond.
        region: x, y, width and height in px of what is compared.
        mask: A file that is not 0 where pixels are compared.
        flip: Whether FLIP is measured.
        metadata: Whether metadata of files that differs fails, too.
        diagnose: Whether the cause of a difference is looked for.
        like: A set of rules where none are given: ``render`` (the same program on another machine),
            ``encoder`` (a lossy codec) or ``golden`` (the same program and machine).

    Returns:
        Its ``status`` (same, warning or different), ``passes``, ``metrics`` by name (max, psnr,
        …), ``findings`` (what happened to b, each with its ``name``, ``text`` and ``values``), the
        ``worst`` pixel, the ``window`` of all that differ, and more.

    Raises:
        InputError: A file cannot be read, or the mask is of another size.
        UsageProblem: A rule makes no sense, or the region is not within the picture.
        ValueError: An array is no picture.
    """
    if like is not None and like not in PRESETS:
        raise UsageProblem(
            "unknown-name", f"'{like}' is not known", f"name {', '.join(PRESETS)}", field="like"
        )
    known = Rules() if like is None else PRESETS[like]
    rules = Rules(_rules("fail", fail) or known.fail, _rules("warn", warn) or known.warn, over)
    settings = CompareSettings(
        region=None if region is None else CropRegion(*region),
        mask=None if mask is None else Path(mask),
        flip=flip,
        metadata=metadata,
        diagnose=diagnose,
    )
    one, other = _picture(a, "a"), _picture(b, "b")
    return compare_pictures(other.path.name, one, other, rules, settings)[0]


def of_planes(planes: dict[str, Any], name: str) -> DecodedPicture:
    """Channels [H, W] of linear light as a picture of that name."""
    height, width = next(iter(planes.values())).shape
    types = {channel: plane.dtype.name for channel, plane in planes.items()}
    return DecodedPicture(Path(name), width, height, planes, types)


def planes_of(image: Any) -> dict[str, Any]:
    """Channels [H, W], half or float, of an array or a tensor."""
    if hasattr(image, "detach"):  # a tensor, whose channels come first
        values = np.asarray(image.detach().cpu().numpy())
        values = values[0] if values.ndim == 4 and values.shape[0] == 1 else values
        values = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
    else:
        values = np.asarray(image)
    if values.dtype.kind not in "fiub":
        raise ValueError(f"image must have real numbers, got {values.dtype}")
    if values.dtype != np.float16:
        wide = values
        with np.errstate(over="ignore"):
            values = values.astype(np.float32)
        if np.any(np.isinf(values) & np.isfinite(wide)):
            raise ValueError(f"image must have values of 32 bits, got {np.nanmax(np.abs(wide)):g}")
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in _CHANNELS or not values.size:
        wanted = "[H, W], [H, W, C] or, as a tensor, [C, H, W] with 1 to 4 channels"
        raise ValueError(f"image must be {wanted}, got {list(np.shape(image))}")
    names = _CHANNELS[values.shape[2]]
    return {name: np.ascontiguousarray(values[..., k]) for k, name in enumerate(names)}


def _picture(image: Any, name: str) -> DecodedPicture:
    if isinstance(image, str) or hasattr(image, "__fspath__"):
        return read_picture(Path(image))
    return of_planes(planes_of(image), name)


def _rules(field: str, texts: Sequence[str]) -> tuple[Rule, ...]:
    texts = [texts] if isinstance(texts, str) else texts
    try:
        return tuple(map(rule, texts))
    except QuantityError as error:
        raise UsageProblem("no-rule", error.problem, error.remedy, field=field) from None
