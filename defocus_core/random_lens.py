"""A random lens for each picture of a batch: data augmentation that obeys the laws of the lens.

A sample's lens depends on its seed and its depth alone, not on the batch, the device or the
process that it is computed in. Lengths are in mm, radii in px.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import index
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.aperture import Aperture
from defocus_core.guards import (
    dense,
    described,
    flag,
    is_picture,
    numbers,
    positive,
    whole,
)
from defocus_core.lens import DefocusLens
from defocus_core.quality import find
from defocus_core.ranges import Range, choices, interval, logarithmic
from defocus_core.render import render
from defocus_core.thin_lens import bad_depth


class RandomlyDefocused(NamedTuple):
    """What `RandomDefocus` returns; the lenses' values are [B] on the CPU, in float64.

    Attributes:
        render: The defocused images, [B, C, H, W].
        left: As seen through the lens half u.x < 0, None if not asked for.
        right: As seen through the lens half u.x >= 0, None if not asked for.
        signed_radius: Of the circle of confusion in px, [B, 1, H, W].
        foclen: Focal lengths in mm.
        fnum: F-numbers.
        foc_dist: Distances in focus in mm, inf where all is sky.
        blades: Blades of the aperture, 0 for a round one.
        blade_rotation: Angle of a blade's vertex in degrees.
    """

    render: Tensor
    left: Tensor | None
    right: Tensor | None
    signed_radius: Tensor
    foclen: Tensor
    fnum: Tensor
    foc_dist: Tensor
    blades: Tensor
    blade_rotation: Tensor


class _Lens(NamedTuple):
    foclen: float
    fnum: float
    foc_dist: float
    blades: int
    blade_rotation: float


class RandomDefocus(torch.nn.Module):
    """Defocuses each picture of a batch with a lens of its own, drawn from ranges by a seed.

    Its attributes are its arguments, and may be set anew, as for a curriculum. Focal length and
    f-number are drawn uniformly in the logarithm, the focus uniformly in the
    percentile of the depth that is not sky, blades from a list, their rotation from the full turn.
    A range with equal ends fixes a value. Gradients flow to image and depth.
    """

    def __init__(
        self,
        *,
        foclen: Range = (24.0, 85.0),
        fnum: Range = (1.4, 16.0),
        focus_percentile: Range = (5.0, 95.0),
        blades: Sequence[int] = (0, 5, 6, 7, 8, 9),
        sensor_width: float = 36.0,
        max_radius: float | None = None,
        left_right: bool = False,
        quality: str = "standard",
        threads: int = 1,
    ) -> None:
        """Say what lenses are drawn from.

        Args:
            foclen: Least and greatest focal length in mm.
            fnum: Least and greatest f-number.
            focus_percentile: Least and greatest percentile of the depth to focus on, 0 to 100.
            blades: Numbers of blades to choose from; 0 is a round aperture.
            sensor_width: Width of the sensor in mm, whatever the size of the picture.
            max_radius: Greatest radius of the blur in px: the f-number is raised, beyond its range
                if need be, until no pixel exceeds it. None for no bound.
            left_right: Whether to return the dual-pixel pair too.
            quality: As for `render`.
            threads: As for `render`.

        Raises:
            ValueError: If a range or a value makes no sense.
        """
        super().__init__()
        self.foclen = foclen
        self.fnum = fnum
        self.focus_percentile = focus_percentile
        self.blades = blades
        self.sensor_width = sensor_width
        self.max_radius = max_radius
        self.left_right = left_right
        self.quality = quality
        self.threads = threads
        self._check()

    def _check(self) -> None:
        """Refuse what makes no sense, at first and where an attribute was set later."""
        self.foclen = interval("foclen", self.foclen)
        self.fnum = interval("fnum", self.fnum)
        self.focus_percentile = interval("focus_percentile", self.focus_percentile, 100.0)
        self.blades = choices(self.blades)
        self.sensor_width = positive("sensor_width", self.sensor_width, "36 is full frame")
        if self.max_radius is not None:
            self.max_radius = positive("max_radius", self.max_radius, "None is no bound")
        flag("left_right", self.left_right)
        find(self.quality)
        self.threads = whole("threads", self.threads, "it is how many tiles are computed at once")

    def extra_repr(self) -> str:
        """What lenses are drawn from, as a module tells it."""
        names = ["foclen", "fnum", "focus_percentile", "blades", "sensor_width", "max_radius"]
        names += ["left_right", "quality", "threads"]
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in names)

    def forward(
        self, image: Tensor, depth: Tensor, seeds: Sequence[int] | Tensor | torch.Generator
    ) -> RandomlyDefocused:
        """Defocus a batch.

        Args:
            image: [B, C, H, W], scene-linear.
            depth: [B, 1, H, W] or [B, H, W], planar depth in mm, > 0, inf for the sky.
            seeds: A whole number for each picture, or a generator to draw them from.

        Returns:
            The pictures, their radii and their lenses.

        Raises:
            ValueError: If shapes disagree, a depth is NaN or not positive, or so near that the lens
                drawn cannot focus on it.
        """
        self._check()
        planes = _planes(image, depth)
        numbers = _seeds(seeds, len(image))
        lenses = [self._draw(*pair) for pair in zip(planes, numbers, strict=True)]
        thin_lenses = [self._thin(lens, planes.shape[1:]) for lens in lenses]
        radii = [thin.signed_radius(plane) for thin, plane in zip(thin_lenses, planes, strict=True)]
        done = [
            render(
                picture,
                radius,
                aperture=Aperture(lens.blades, lens.blade_rotation),
                quality=self.quality,
                left_right=self.left_right,
                threads=self.threads,
                infinity=thin.radius_at_infinity(),
            )
            for picture, radius, lens, thin in zip(image, radii, lenses, thin_lenses, strict=True)
        ]
        sides: tuple[Tensor | None, Tensor | None] = (None, None)
        if self.left_right:
            sides = _stacked([one.left for one in done]), _stacked([one.right for one in done])
        drawn = [
            torch.tensor(values, dtype=torch.float64, device="cpu")
            for values in zip(*lenses, strict=True)
        ]
        return RandomlyDefocused(
            torch.stack([one.render for one in done]), *sides, torch.stack(radii)[:, None], *drawn
        )

    def _draw(self, depth: Tensor, seed: int) -> _Lens:
        """The lens of a seed, for a depth map [H, W]."""
        generator = torch.Generator("cpu").manual_seed(seed)
        shares = torch.rand(5, generator=generator, dtype=torch.float64, device="cpu").tolist()
        foclen = logarithmic(self.foclen, shares[0])
        fnum = logarithmic(self.fnum, shares[1])
        low, high = self.focus_percentile
        percent = low + (high - low) * shares[2]
        foc_dist = _percentile(depth.detach(), percent)
        if not foc_dist > foclen:
            raise ValueError(
                f"depth must be farther in focus than the focal length, got {foc_dist:g} mm at "
                f"percentile {percent:.3g} for {foclen:g} mm; depth is in mm, and drawn are "
                f"foclen={self.foclen} and focus_percentile={self.focus_percentile}"
            )
        blades = self.blades[int(shares[3] * len(self.blades))]
        lens = _Lens(foclen, fnum, foc_dist, blades, 360.0 * shares[4])
        if self.max_radius is None:
            return lens
        extremes = torch.stack([depth.detach().min(), depth.detach().max()]).double()[None]
        greatest = float(self._thin(lens, depth.shape).signed_radius(extremes).abs().max())
        return lens._replace(fnum=fnum * max(1.0, greatest / self.max_radius))

    def _thin(self, lens: _Lens, size: torch.Size) -> DefocusLens:
        """A lens before a sensor of so many (height, width) px."""
        height, width = size
        thin = DefocusLens(
            lens.foclen,
            lens.fnum,
            (self.sensor_width, self.sensor_width * height / width),
            (width, height),
        )
        thin.refocus(lens.foc_dist)
        return thin


def _planes(image: Tensor, depth: Tensor) -> Tensor:
    """Depth [B, H, W], once it is known to agree with the image, and to be positive."""
    dense("image", image)
    if not is_picture(image, 4):
        raise ValueError(
            f"image must be a floating-point tensor [B, C, H, W], got {described(image)}; "
            "one image is image[None]"
        )
    if not image.numel():
        raise ValueError(
            f"image must hold a pixel, got {list(image.shape)}; leave out what holds none"
        )
    batch, _, height, width = image.shape
    depth = numbers("depth", depth, torch.float32, image.device)
    planes = depth[:, 0] if depth.ndim == 4 and depth.shape[1] == 1 else depth
    if planes.shape != (batch, height, width):
        raise ValueError(
            f"depth must be [B, 1, H, W] or [B, H, W] with the image's B={batch}, H={height}, "
            f"W={width}, got {list(depth.shape)}; resample it by nearest neighbour"
        )
    if not bool((planes > 0).all()):
        raise bad_depth("depth", planes, planes > 0, "positive")
    return planes


def _seeds(seeds: Sequence[int] | Tensor | torch.Generator, count: int) -> list[int]:
    if isinstance(seeds, torch.Generator):
        device = seeds.device
        drawn = torch.randint(2**63 - 1, (count,), generator=seeds, device=device)
        return [int(seed) for seed in drawn]
    wanted = f"seeds must be one whole number for each picture, a list of {count}"
    remedy = "the indices of the samples will do"
    try:
        found = [index(seed) for seed in seeds]
    except TypeError:
        raise ValueError(f"{wanted}, got {described(seeds)}; {remedy}") from None
    if len(found) != count:
        raise ValueError(f"{wanted}, got one of {len(found)}; {remedy}")
    for seed in found:
        if not -(2**63) <= seed < 2**64:
            raise ValueError(f"seeds must be of 64 bits, got {seed}; take it modulo 2**64")
    return found


def _percentile(depth: Tensor, percent: float) -> float:
    """The distance of a pixel that so many percent of those that are not sky do not exceed."""
    solid = depth[torch.isfinite(depth)]
    if not solid.numel():
        return math.inf
    rank = math.ceil(percent / 100 * solid.numel())
    return float(torch.kthvalue(solid, max(rank, 1))[0])


def _stacked(pictures: Sequence[Tensor | None]) -> Tensor:
    return torch.stack([picture for picture in pictures if picture is not None])
