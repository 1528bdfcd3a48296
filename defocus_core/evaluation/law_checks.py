"""Checks of laws: the setting to render in, and the worst value with its bound."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from defocus_core.evaluation.law_probes import Probe
from defocus_core.optics.aperture import Aperture
from defocus_core.renderer.render import render
from defocus_core.tensors.views import Views


@dataclass(frozen=True)
class LawSetting:
    """The setting that probes are rendered in.

    Attributes:
        device: Where to compute, as torch calls it.
        quality: As for `render`.
        threads: As for `render`.
    """

    device: str = "cpu"
    quality: str = "standard"
    threads: int = 1


@dataclass(frozen=True)
class Check:
    """One number that a law bounds.

    Attributes:
        law: Its name.
        measured: The measurement, in words.
        unit: Unit of the value and the bound.
        value: The worst value measured; None if there was nothing to measure it on.
        bound: The largest value that the law allows.
    """

    law: str
    measured: str
    unit: str
    value: float | None
    bound: float

    @property
    def ok(self) -> bool:
        """Whether the law holds: a value that was not measured does not break it, NaN does."""
        return self.value is None or self.value <= self.bound


def rendered(
    scene: Probe,
    setting: LawSetting,
    dtype: torch.dtype,
    *,
    aperture: Aperture | None = None,
    left_right: bool = True,
    threads: int | None = None,
) -> Views:
    """The rendering of a scene, with `setting.threads` unless ``threads`` says otherwise."""
    image, radius = (x.to(setting.device, dtype).contiguous() for x in scene)
    return render(
        image,
        radius,
        aperture=aperture,
        quality=setting.quality,
        left_right=left_right,
        threads=threads or setting.threads,
    )


def pictures(views: Views) -> tuple[Tensor, Tensor, Tensor]:
    """Centre, left and right."""
    assert views.left is not None
    assert views.right is not None
    return views.render, views.left, views.right


def greatest(values: list[float]) -> float:
    """The greatest; NaN if one is, as max() would not say."""
    return math.nan if any(map(math.isnan, values)) else max(values)
