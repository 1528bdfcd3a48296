"""The kernel bank: sampled kernels, their spectra, and the Fourier windows of slices.

A tile is blurred within a window of at least tile + 2 reach px, rounded up to a length with a fast
transform, so that the circular convolution wraps around outside the tile.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.parts import Part
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import launches_cost, sent
from defocus_core.tensors.threads import requires_grad

# Number of kernels cached for further frames, more than a picture has slices.
_MAX_KERNELS = 256


def reach(radius: float, limit: int) -> int:
    """The distance in px from the middle of a slice's kernel to its last pixel, at most `limit`.

    It is 0 if the kernel is a single pixel.
    """
    return 0 if abs(radius) <= 0.5 else min(math.ceil(abs(radius) - 0.5), limit)


def _transform_lengths(limit: int) -> list[int]:
    """Multiples of 16, up to 2 `limit`, of the form 2^a 3^b 5^c 7^d with b <= 2 and c, d <= 1.

    Transforms of these lengths are up to 1.6 times as fast per sample as transforms of similar
    length.
    """
    odd = [3**b * 5**c * 7**d for b in range(3) for c in range(2) for d in range(2)]
    powers = [2**a for a in range(4, limit.bit_length() + 1)]
    return sorted(two * other for two in powers for other in odd if two * other <= 2 * limit)


_LENGTHS = _transform_lengths(1 << 20)


def transform_length(n: int) -> int:
    """The least length of at least n px for which Fourier transforms are fast."""
    return _LENGTHS[bisect_left(_LENGTHS, n)]


def kernels(
    radii: Tensor,  # [K] signed radii in px, float64
    extent: int,  # greatest reach of the kernels in px
    aperture: Aperture,
    parts: list[Part],
    *,
    views: Sequence[Rim] = (),
    leaning: bool = False,
) -> Tensor:
    """Sampled kernels of all parts of the pupil, each centred in a square.

    Returns [K, 1, M, S, S] for K radii and M parts, with S = 2 extent + 1. If `leaning`, returns
    [K, 3, M, S, S]: kernels, kernels times u.x, and kernels times u.y. With `views`, the pupils
    seen from points of the frame, M is the number of parts times the number of points.
    """
    view = Rim.concatenate(views) if views else None
    # a region keeps its own
    draw = _kernel.__wrapped__ if aperture.requires_grad or view else _kernel
    pupil = aperture if aperture.requires_grad else aperture.fixed
    of_slices = [
        torch.cat([draw(radius, extent, pupil, part, view, leaning) for part in parts], 1)
        for radius in radii.tolist()
    ]
    return torch.stack(of_slices)


@lru_cache(maxsize=_MAX_KERNELS)
def _kernel(
    radius: float, extent: int, aperture: Aperture, part: Part, view: Rim | None, leaning: bool
) -> Tensor:
    """The kernels [1 or 3, V, S, S] of one part of the pupil, as described by `kernels`.

    V is the number of points in `view`, or 1. Kernels are cached, as all frames use the same radii.
    """
    with torch.inference_mode(False):  # it is cached for calls that need gradients, too
        r = torch.tensor([radius], dtype=torch.float64, device="cpu")
        points = r if view is None else r.expand(view.points)
        plain = aperture.kernel(points, 2 * extent + 1, part, view)[None]
        if not leaning:
            return plain
        return torch.cat([plain, plain * _lens_points(r[0], extent, aperture)[:, None]])


def kernel_spectra(kernels: Tensor, window: tuple[int, int]) -> Tensor:
    """Fourier transforms [..., height, width // 2 + 1] of kernels, centred on pixel (0, 0).

    `kernels`: [..., S, S], S an odd number; `window`: (height, width) of the transform, each more
    than S // 2. Rows and columns of a kernel beyond the window affect no sample that is kept, and
    are left out.
    """
    size = kernels.shape[-1]
    whole = torch.nn.functional.pad(kernels, (0, window[1] - size, 0, window[0] - size))
    centred = whole.roll((-(size // 2), -(size // 2)), (-2, -1))
    if launches_cost(kernels.device):
        spectra: Tensor = torch.fft.rfft2(centred)
        return spectra
    # one at a time: on some processors the batch size changes the last digits
    spectra = torch.stack([torch.fft.rfft2(one) for one in centred.reshape(-1, *window)])
    return spectra.view(*kernels.shape[:-2], *spectra.shape[-2:])


def _lens_points(radius: Tensor, extent: int, aperture: Aperture) -> Tensor:
    """The lens point u that sends light to each pixel of a kernel: [2, S, S], x then y.

    u is offset / r, slightly reduced, as sampling by area adds 1/12 px² to the second moment: the
    mean of u times offset is r / 4, as over a round pupil, and less along a squeezed axis. u is at
    most 1 long, so that a tilted kernel is never negative.
    """
    offset = torch.arange(-extent, extent + 1, dtype=radius.dtype)
    across, down = (
        offset * (radius / (radius * radius + narrower * narrower / 3))
        for narrower in aperture.narrowing
    )
    u = torch.stack(torch.meshgrid(across, down, indexing="xy"))
    return u / (u * u).sum(0).clamp(min=1).sqrt()


def blurred(
    terms: list[tuple[Tensor, Tensor]], groups: list[slice], window: tuple[int, int], box: Box
) -> Tensor:
    """Blurred pixels [M, C + 1, ..., h, w] in a box of the transform's window.

    `terms`: pairs of the spectrum of pixels [C + 1, ...] and the spectra of kernels [M, 1, ...],
    whose products are summed; `groups`: ranges of parts, each computed at once; `window`: (height,
    width) of the transform.
    """
    every = [slice(None)] if launches_cost(terms[0][0].device) else groups
    # on a CPU how many parts are computed together may change the last digits
    blurred_parts = [_blurred_part(terms, group, window, box) for group in every]
    return blurred_parts[0] if len(every) == 1 else torch.cat(blurred_parts)


def _blurred_part(
    terms: list[tuple[Tensor, Tensor]], group: slice, window: tuple[int, int], box: Box
) -> Tensor:
    """`blurred` for a group of parts."""
    (spectrum, kernel), *others = terms
    total = spectrum * kernel[group]
    for spectrum, kernel in others:
        total = total.addcmul_(spectrum, kernel[group])
    # along rows, only those in the box are transformed
    rows = torch.fft.ifft(total, dim=-2)[..., box.top : box.top + box.height, :]
    whole: Tensor = torch.fft.irfft(rows, n=window[1], dim=-1)
    return whole[..., box.left : box.left + box.width]


# Mean number of slopes of a slice whose tilted kernels are cached.
_PLANES = 4


class Spread(NamedTuple):
    """How a slice is blurred: at which resolution, and how far its light reaches."""

    level: int  # how many times resolution is halved
    coarse: int  # reach of its kernel in pixels of that resolution
    px: int  # greatest reach of its light in pixels of the picture


@dataclass(frozen=True)
class TransformWindow:
    """The Fourier transform that the slices of a layer share, and their cached kernels."""

    margin: int  # greatest reach of the slices in px; 0 if they are not blurred at all
    size: tuple[int, int]  # (height, width) of the transform
    level: int  # how many times resolution is halved; margin and size are in px of that resolution
    slices: list[int]  # numbers of the slices that are used
    radii: Tensor  # [k] radii of the slices in px, float64
    aperture: Aperture
    parts: list[Part]  # the parts of the pupil
    like: Tensor  # a tensor of the dtype and device of the spectra
    views: tuple[Rim, ...] = ()  # views of the pupil: M counts each part once with each
    # Cached kernels, by number of the slice
    kernels: dict[int, Tensor] = field(default_factory=dict)
    # Cached spectra, by number of the slice, and whether they lean
    spectra: dict[tuple[int, bool], Tensor] = field(default_factory=dict)
    # Cached spectra of kernels tilted for planes, by number and slope
    planes: dict[tuple[int, tuple[float, float]], Tensor] = field(default_factory=dict)

    @property
    def requires_grad(self) -> bool:
        """Whether gradients flow to the pupil; spectra are then recomputed, not cached."""
        return self.aperture.requires_grad or requires_grad(self.views)

    def seen(self, views: Sequence[Rim]) -> TransformWindow:
        """The same window with the pupil as seen from points of the frame."""
        window = replace(self, views=tuple(views), kernels={}, spectra={}, planes={})
        window.prepare()
        return window

    def prepare(self) -> None:
        """Compute kernels with gradients once, outside of the work that a backward pass repeats."""
        for slice_index in self.slices if self.requires_grad and self.margin else ():
            self._kernels([slice_index], leaning=True)

    def spectrum(self, slice_index: int, *, leaning: bool = False) -> Tensor:
        """The spectra [M, 1, height, width // 2 + 1] of a slice's kernels.

        If `leaning`, [2, M, 1, ...]: the spectra of the kernels times u.x and times u.y, for tilted
        surfaces.
        """
        spectrum = self.spectra.get((slice_index, leaning))
        if spectrum is not None:
            return spectrum
        if self.requires_grad:  # a backward pass computes it again
            return self._transformed([slice_index], leaning=leaning)[0]
        slice_indices = self.slices if launches_cost(self.like.device) else [slice_index]
        spectra = self._transformed(slice_indices, leaning=leaning)
        for each, spectrum in zip(slice_indices, spectra, strict=True):
            self.spectra[each, leaning] = spectrum
        return self.spectra[slice_index, leaning]

    def tilted(self, slopes: Mapping[int, tuple[float, float]]) -> dict[int, Tensor]:
        """The spectra [M, 1, ...] of the kernels of slices that are tilted planes, by slice.

        `slopes`: for each slice, the slopes of its radius along x and y, in px per px.
        """
        if self.requires_grad or len(self.planes) > _PLANES * len(self.slices):
            self.planes.clear()
        known = dict(self.planes)  # other threads may clear it
        found = {n: known[n, slope] for n, slope in slopes.items() if (n, slope) in known}
        missing = [number for number in slopes if number not in found]
        if missing:
            versions = torch.stack(self._kernels(missing, leaning=True), 1)
            leans = sent([slopes[number] for number in missing], versions)
            x, y = leans.T.view(2, -1, *[1] * (versions.dim() - 2))
            tilted = versions[0].addcmul(versions[1], x).addcmul(versions[2], y)
            spectra = kernel_spectra(tilted, self.size).unsqueeze(2)
            made = dict(zip(missing, spectra.unbind(), strict=True))
            self.planes.update({(number, slopes[number]): each for number, each in made.items()})
            found |= made
        return found

    def _transformed(self, slice_indices: list[int], *, leaning: bool) -> Sequence[Tensor]:
        """The spectra of several slices, each as `spectrum` returns it."""
        versions = self._kernels(slice_indices, leaning=leaning)
        chosen = torch.stack([each[1:] if leaning else each[0] for each in versions])
        return kernel_spectra(chosen, self.size).unsqueeze(2 + leaning).unbind()

    def _kernels(self, slice_indices: list[int], *, leaning: bool) -> list[Tensor]:
        """The kernels of slices, computed singly, since a batch could change the last digits."""
        versions = 3 if leaning else 1
        missing = [
            n for n in slice_indices if n not in self.kernels or len(self.kernels[n]) < versions
        ]
        if missing:
            radii = self.radii[[self.slices.index(n) for n in missing]] / (1 << self.level)
            computed = kernels(
                radii, self.margin, self.aperture, self.parts, views=self.views, leaning=leaning
            )
            self.kernels.update(zip(missing, sent(computed, self.like.real), strict=True))
        return [self.kernels[n] for n in slice_indices]


def transform_windows(
    radii: tuple[float, ...],
    spreads: list[Spread],
    layers: list[int],
    side: tuple[int, int],
    region: tuple[int, int],
    aperture: Aperture,
    parts: list[Part],
    like: Tensor,
    stride: int,
) -> list[TransformWindow]:
    """The transform window of each slice; the slices of a layer share a window.

    `radii`: of the slices, in px; `layers`: for each slice, the number of its layer; `side`:
    (height, width) in px of a tile, which is blurred at once at full resolution; `region`: the same
    of a region, which is blurred at once at reduced resolution; `like`: a tensor of the dtype and
    device of spectra; `stride`: 1 if every slice is used, 2 for every other slice.
    """
    sharing: dict[int, list[int]] = {}
    for k, slice_index in enumerate(layers):
        sharing.setdefault(slice_index, []).append(k)
    window_of: dict[int, TransformWindow] = {}
    for slices in sharing.values():
        extent, level = max(spreads[k].coarse for k in slices), spreads[slices[0]].level
        extents = [(n >> level) + 5 for n in region] if level else side
        rows, columns = (transform_length(n + 2 * extent) for n in extents)
        used = [k for k in slices if k % stride == 0]
        layer_radii = torch.tensor([radii[k] for k in used], dtype=torch.float64)
        size = rows, columns
        window = TransformWindow(extent, size, level, used, layer_radii, aperture, parts, like)
        window.prepare()
        window_of.update(dict.fromkeys(slices, window))
    return [window_of[k] for k in range(len(radii))]


def spreads_of(
    radii: tuple[float, ...], layers: list[int], full_resolution: float, limit: int
) -> list[Spread]:
    """The spread of each slice; the slices of a layer are blurred at the same resolution.

    `radii`: radii of the slices in px; `layers`: for each slice, the number of its layer;
    `full_resolution`: radius in px at which resolution is halved, and halved again at each doubling
    of the radius; `limit`: greatest reach in px, the size of the frame.
    """
    minimum: dict[int, float] = {}
    for radius, slice_index in zip(radii, layers, strict=True):
        minimum[slice_index] = min(minimum.get(slice_index, math.inf), abs(radius))
    spreads = []
    for radius, slice_index in zip(radii, layers, strict=True):
        ratio = min(minimum[slice_index], limit) / full_resolution
        level = math.floor(math.log2(ratio)) + 1 if ratio >= 1 else 0
        step = 1 << level
        coarse = reach(radius / step, -(-limit // step))
        # a pixel has shares in coarse pixels beside it, and is read from two coarse pixels on each
        # side
        px = min(step * (coarse + 3) - 1, limit) if level else coarse
        spreads.append(Spread(level, coarse, px))
    return spreads


class Slicing(NamedTuple):
    """How the slices of visible or of invented surfaces are blurred."""

    stride: int  # whether every slice (1) or every other (2) is used
    level: int  # how many times resolution is halved before the blur
    # The window of each slice of the frame, in coarse pixels of this resolution
    windows: list[TransformWindow]
    # For each slice the number of its layer; slices of a layer share a window, and are of one
    # octave of blur if they are hidden
    layers: list[int]
    # For each slice the greatest reach of its light in coarse pixels of this resolution
    coarse: list[int]
