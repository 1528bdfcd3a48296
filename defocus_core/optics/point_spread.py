"""Point spread functions of the thin lens: whole and dual-pixel, of points and of grids.

Points are (x, y, z): x and y from -1 to 1 on the sensor, z in mm of either sign. The response does
not vary over the image, so x and y are not used.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.parts import LEFT
from defocus_core.optics.thin_lens import ThinLens
from defocus_core.tensors.validation import Scalar, flag, number, whole

# Kernels no longer change with radii above this times ks.
_LEVEL = 1000
# Below the first radius in px, kernels of halves have an exact distance from each other; above the
# second, exact areas, which give the distance to 1 %; between, a mixture.
_EXACT_DISTANCE, _EXACT_AREAS = 4.0, 8.0
# Smaller shifts in px are rounding errors.
_NO_SHIFT = 1e-6


class PsfLens(ThinLens):
    """A thin lens that draws the blur of points.

    A kernel of `ks` px has its centre at (ks - 1) / 2 on both axes: for an even ks the corner
    between the four middle pixels.
    """

    def psf(
        self,
        points: Tensor,
        wvln: float | None = None,
        ks: int = 64,
        psf_type: str = "gaussian",
        strict: bool = False,
    ) -> Tensor:
        """The response to points: the CoC disc, area-sampled, the same everywhere in the image.

        Args:
            points: (x, y, z) of each point, [N, 3] or [3].
            wvln: Wavelength, as other lenses of DeepLens take it; the blur has no colour, so it is
                not used.
            ks: Kernel size in px, odd or even.
            psf_type: "pillbox", or "gaussian", exp(-d² / 2r²) at distance d in a disc of radius r.
            strict: Whether a CoC wider than ks is an error.

        Returns:
            [N, ks, ks] or [ks, ks], summing to 1.

        Raises:
            ValueError: If points have another shape, a z is 0 or NaN, psf_type is unknown, or the
                CoC is wider than ks and `strict` is set (the message names the ks needed).

        Warns:
            UserWarning: If the CoC is wider than ks: the kernel is cropped to its middle and
                normalised to a sum of 1.
        """
        radii, ks = self._radii(points, ks, strict)
        return _normalise(Aperture(psf_type=psf_type).kernel(radii, ks), radii)

    def psf_rgb(
        self, points: Tensor, ks: int = 64, psf_type: str = "gaussian", strict: bool = False
    ) -> Tensor:
        """`psf` for three equal channels: [N, 3, ks, ks], or [3, ks, ks] for one point."""
        return _three(self.psf(points, None, ks, psf_type, strict))

    def psf_map(
        self,
        grid: tuple[int, int] = (5, 5),
        ks: int = 64,
        depth: Scalar | None = None,
        psf_type: str = "gaussian",
        strict: bool = False,
    ) -> Tensor:
        """`psf` at one depth for a grid over the image.

        Args:
            grid: (rows, columns).
            ks: Kernel size in px.
            depth: Object depth in mm; None takes the attribute `obj_depth`.
            psf_type: As for `psf`.
            strict: As for `psf`.

        Returns:
            [rows, columns, 1, ks, ks], all equal.

        Raises:
            ValueError: If a grid has no rows or no columns; otherwise as `psf`.
        """
        psf = self.psf(self._axis_point(depth), None, ks, psf_type, strict)
        return psf.repeat(*_grid_of(grid), 1, 1, 1)

    def psf_map_rgb(
        self,
        grid: tuple[int, int] = (5, 5),
        ks: int = 64,
        depth: Scalar | None = None,
        psf_type: str = "gaussian",
        strict: bool = False,
    ) -> Tensor:
        """`psf_map` for three equal channels: [rows, columns, 3, ks, ks]."""
        return self.psf_map(grid, ks, depth, psf_type, strict).repeat(1, 1, 3, 1, 1)

    def psf_dp(
        self, points: Tensor, ks: int = 64, psf_type: str = "gaussian", strict: bool = False
    ) -> tuple[Tensor, Tensor]:
        """The responses of the left and the right dual pixels.

        The left one is seen through the half u.x < 0 of the lens: a point beyond focus lies to the
        left in it, and one nearer than focus to the right. The mean of both is `psf`. For a pillbox
        their centroids are 8 r / (3 pi) px apart, even near focus. There, kernels with an odd ks
        have values below zero, down to -0.11: each is shifted by a fraction of a pixel, while their
        mean is a single pixel.

        Returns:
            (left, right), each as `psf` returns it, each summing to 1.
        """
        radii, ks = self._radii(points, ks, strict)
        aperture = Aperture(psf_type=psf_type)
        left = _left_half(radii, ks, aperture)
        return left, left.flip(-1)

    def psf_rgb_dp(
        self, points: Tensor, ks: int = 64, psf_type: str = "gaussian", strict: bool = False
    ) -> tuple[Tensor, Tensor]:
        """`psf_dp` for three equal channels: (left, right), each [N, 3, ks, ks]."""
        left, right = self.psf_dp(points, ks, psf_type, strict)
        return _three(left), _three(right)

    def psf_map_dp(
        self,
        grid: tuple[int, int] = (5, 5),
        ks: int = 64,
        depth: Scalar | None = None,
        psf_type: str = "gaussian",
        strict: bool = False,
    ) -> tuple[Tensor, Tensor]:
        """`psf_dp` at one depth over a grid, with the arguments of `psf_map`.

        Returns:
            (left, right), each [rows, columns, 1, ks, ks].
        """
        left, right = self.psf_dp(self._axis_point(depth), ks, psf_type, strict)
        times = (*_grid_of(grid), 1, 1, 1)
        return left.repeat(times), right.repeat(times)

    def _radii(self, points: Tensor, ks: int, strict: bool) -> tuple[Tensor, int]:
        """The signed radii in px of points, clamped to ±1000 ks, and ks as a checked whole number.

        A blur wider than ks is an error if `strict` is set, else a warning.
        """
        points = self._tensor("points", points)
        if points.ndim not in (1, 2) or points.shape[-1] != 3:
            raise ValueError(
                f"points must be [N, 3] or [3] (x, y, z), got {list(points.shape)}; "
                "z in mm is the last column"
            )
        radii = ThinLens.signed_radius(self, self._distance("depth", points[..., 2]))
        ks = whole("ks", ks, "it is in px, 64 by default")
        strict, cut = flag("strict", strict), _cut(radii, ks)
        if bool(cut.any()):
            widest = 2 * radii.detach().abs().max()
            problem = (
                f"ks must hold the circle of confusion, {float(widest):.6g} px across, got {ks}; "
                f"use ks={float(widest.ceil()):.0f} or more"
            )
            if strict:
                raise ValueError(problem)
            warnings.warn(f"kernels are cropped: {problem}", UserWarning, stacklevel=3)
        return radii.clamp(-_LEVEL * ks, _LEVEL * ks), ks

    def _axis_point(self, depth: Scalar | None) -> Tensor:
        name, value = ("obj_depth", self.obj_depth) if depth is None else ("depth", depth)
        number(name, value, "one map is of one depth in mm")
        z = self._distance(name, value).reshape(())
        return torch.stack([torch.zeros_like(z), torch.zeros_like(z), z])


def _cut(radii: Tensor, ks: int) -> Tensor:
    """Whether a kernel of ks px cuts off the blur of each radius: bool, shape of radii."""
    return 2 * radii.detach().abs() > ks * (1 + 1e-6)


def _normalise(kernel: Tensor, radii: Tensor) -> Tensor:
    """Kernels [..., ks, ks], divided by their sum where ks cuts them off."""
    cut = _cut(radii, kernel.shape[-1])[..., None, None]
    return torch.where(cut, kernel / kernel.sum((-2, -1), keepdim=True), kernel)


def _left_half(radii: Tensor, ks: int, aperture: Aperture) -> Tensor:
    """Kernels [..., ks, ks] of the left half of a round aperture.

    Sampling by area does not resolve positions within a pixel: near focus the two halves would be 0
    px apart for an odd ks, and 1 px for an even one. So the difference of half and whole is scaled,
    by 1 at most, towards the shift that the lens gives; the rest of the shift is made by adding a
    multiple of the whole's slope. Neither changes the mean of the two halves.
    """
    even = _normalise(aperture.kernel(radii, ks), radii)
    odd = _normalise(aperture.kernel(radii, ks, LEFT), radii) - even
    beside = torch.nn.functional.pad(even, (1, 1))
    slope = (beside[..., :-2] - beside[..., 2:]) / 2
    x = torch.arange(ks, dtype=even.dtype, device=even.device) - (ks - 1) / 2
    shift = radii * aperture.centroid(LEFT)[0]
    odd_shift, slope_shift = odd.sum(-2) @ x, slope.sum(-2) @ x
    near = (_EXACT_AREAS - radii.detach().abs()) / (_EXACT_AREAS - _EXACT_DISTANCE)
    near = near.clamp(0, 1) * ~_cut(radii, ks)
    times = 1 + near * (_ratio(shift, odd_shift, otherwise=1.0).clamp(max=1) - 1)
    missing = near * _ratio(shift - times * odd_shift, slope_shift, otherwise=0.0)
    return even + times[..., None, None] * odd + missing[..., None, None] * slope


def _ratio(part: Tensor, whole: Tensor, otherwise: float) -> Tensor:
    """The ratio of two shifts in px; `otherwise` where the divisor is 0."""
    shifted = whole.abs() > _NO_SHIFT
    return torch.where(shifted, part / torch.where(shifted, whole, 1.0), otherwise)


def _three(psf: Tensor) -> Tensor:
    return torch.stack([psf, psf, psf], dim=-3)


def _grid_of(grid: tuple[int, int]) -> tuple[int, int]:
    """A grid (rows, columns), checked: whole numbers of at least 1."""
    try:
        rows, columns = grid
        return whole("rows", rows, ""), whole("columns", columns, "")
    except (TypeError, ValueError):
        raise ValueError(
            f"grid must be (rows, columns), whole numbers of at least 1 each, got {grid}; "
            "it is (5, 5) by default"
        ) from None
