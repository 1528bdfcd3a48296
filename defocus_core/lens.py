"""DefocusLens: the thin lens with DeepLens' interface, its PSFs and its renderer.

Methods that take object-space z (`psf`, `coc`, `dof`, `refocus`) follow the optics habit z < 0 in
front of the lens; a positive depth means the same distance. Renderers take maps of positive planar
depth in mm. The response does not vary over the image.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.optics.aperture import FULL, LEFT, RIGHT, Aperture, Part, kernel
from defocus_core.optics.thin_lens import Scalar, ThinLens
from defocus_core.render import render
from defocus_core.runtime.validation import depth_maps, device_named, floating, number, whole


class DefocusLens(ThinLens):
    """A thin lens that draws the blur of points and renders images with their depth."""

    def psf(self, points: Tensor, ks: int = 64, psf_type: str = "gaussian") -> Tensor:
        """The response to points: the CoC disc, area-sampled, the same everywhere in the image.

        Args:
            points: [N, 3] or [3]: x and y from -1 to 1 on the sensor (not used), z in mm.
            ks: Kernel size in px, odd or even; the centre is at (ks - 1) / 2.
            psf_type: "gaussian", exp(-d² / 2r²) inside the disc, or "pillbox".

        Returns:
            [N, ks, ks] or [ks, ks], summing to 1.

        Raises:
            ValueError: If points have another shape, a z is 0 or NaN, the CoC is wider than ks (the
                message says the ks it needs), or psf_type is unknown.
        """
        return _fitted(self._radii(points), ks, Aperture(psf_type=psf_type), FULL)

    def psf_rgb(self, points: Tensor, ks: int = 64, psf_type: str = "gaussian") -> Tensor:
        """`psf` for three equal channels: [N, 3, ks, ks], or [3, ks, ks] for one point."""
        return _three(self.psf(points, ks, psf_type))

    def psf_map(
        self,
        grid: tuple[int, int] = (5, 5),
        ks: int = 64,
        depth: Scalar | None = None,
        psf_type: str = "gaussian",
    ) -> Tensor:
        """`psf` at one depth for a grid over the image.

        Args:
            grid: (rows, columns).
            ks: Kernel size in px.
            depth: Object depth in mm; None is `obj_depth`.
            psf_type: As for `psf`.

        Returns:
            [rows, columns, 1, ks, ks], all equal.

        Raises:
            ValueError: If a grid has no rows or no columns.
        """
        rows, columns = _checked(grid)
        return self.psf(self._axis_point(depth), ks, psf_type).repeat(rows, columns, 1, 1, 1)

    def psf_dp(
        self, points: Tensor, ks: int = 64, psf_type: str = "gaussian"
    ) -> tuple[Tensor, Tensor]:
        """The responses of the left and the right dual pixels.

        The left one is seen through the half u.x < 0 of the lens: a point beyond focus lies to the
        left in it, one nearer than focus to the right. Their mean is `psf`.

        Returns:
            (left, right), each as `psf` returns it, each summing to 1.
        """
        radii, aperture = self._radii(points), Aperture(psf_type=psf_type)
        return _fitted(radii, ks, aperture, LEFT), _fitted(radii, ks, aperture, RIGHT)

    def psf_rgb_dp(
        self, points: Tensor, ks: int = 64, psf_type: str = "gaussian"
    ) -> tuple[Tensor, Tensor]:
        """`psf_dp` for three equal channels: (left, right), each [N, 3, ks, ks]."""
        left, right = self.psf_dp(points, ks, psf_type)
        return _three(left), _three(right)

    def psf_map_dp(
        self,
        grid: tuple[int, int] = (5, 5),
        ks: int = 64,
        depth: Scalar | None = None,
        psf_type: str = "gaussian",
    ) -> tuple[Tensor, Tensor]:
        """`psf_dp` over a grid, as `psf_map`: (left, right), each [rows, columns, 1, ks, ks]."""
        rows, columns = _checked(grid)
        left, right = self.psf_dp(self._axis_point(depth), ks, psf_type)
        return left.repeat(rows, columns, 1, 1, 1), right.repeat(rows, columns, 1, 1, 1)

    def render_rgbd(
        self,
        img_obj: Tensor,
        depth_map: Tensor,
        psf_ks: int | None = None,
        num_layers: int | None = None,
        psf_type: str = "pillbox",
        depth_repair: str = "auto",
    ) -> Tensor:
        """The defocused image of an all-in-focus one with its depth.

        Args:
            img_obj: [B, C, H, W], scene-linear, at most as large as sensor_res.
            depth_map: [B, 1, H, W] or [B, H, W], planar depth in mm, > 0, inf for the sky.
            psf_ks: Largest kernel allowed in px; None lets the scene decide.
            num_layers: Exactly this many slices; None lets the scene decide.
            psf_type: "pillbox", the thin lens, or "gaussian".
            depth_repair: As for `render`.

        Returns:
            [B, C, H, W].

        Raises:
            ValueError: If shapes disagree, a depth is NaN or not positive, the image is larger than
                the sensor, or the CoC does not fit psf_ks.
        """
        return render(
            img_obj,
            self._image_radius(img_obj, depth_map),
            aperture=Aperture(psf_type=psf_type),
            num_layers=num_layers,
            psf_ks=psf_ks,
            infinity=self.radius_at_infinity(),
            depth_repair=depth_repair,
        ).render

    def render_rgbd_dp(
        self,
        rgb_img: Tensor,
        depth: Tensor,
        psf_ks: int | None = None,
        num_layers: int | None = None,
        psf_type: str = "pillbox",
        depth_repair: str = "auto",
    ) -> tuple[Tensor, Tensor]:
        """The images of the left and the right dual pixels, whose mean is `render_rgbd`.

        Args:
            rgb_img: As `render_rgbd`'s img_obj, any number of channels.
            depth: As `render_rgbd`'s depth_map.
            psf_ks: As for `render_rgbd`.
            num_layers: As for `render_rgbd`.
            psf_type: As for `render_rgbd`.
            depth_repair: As for `render`.

        Returns:
            (left, right), each [B, C, H, W].

        Raises:
            ValueError: As `render_rgbd`.
        """
        rendering = render(
            rgb_img,
            self._image_radius(rgb_img, depth),
            aperture=Aperture(psf_type=psf_type),
            left_right=True,
            num_layers=num_layers,
            psf_ks=psf_ks,
            infinity=self.radius_at_infinity(),
            depth_repair=depth_repair,
        )
        assert rendering.left is not None
        assert rendering.right is not None
        return rendering.left, rendering.right

    def _radii(self, points: Tensor) -> Tensor:
        points = self._tensor("points", points)
        if points.ndim not in (1, 2) or points.shape[-1] != 3:
            raise ValueError(
                f"points must be [N, 3] or [3] (x, y, z), got {list(points.shape)}; "
                "z in mm is the last column"
            )
        return self.signed_coc(points[..., 2]) / (2 * self.pixel_size)

    def _axis_point(self, depth: Scalar | None) -> Tensor:
        name, given = ("obj_depth", self.obj_depth) if depth is None else ("depth", depth)
        number(name, given, "one map is of one depth in mm")
        z = self._distance(name, given).reshape(())
        return torch.stack([torch.zeros_like(z), torch.zeros_like(z), z])

    def _image_radius(self, image: Tensor, depth: Tensor) -> Tensor:
        """Signed radii [B, 1, H, W] of a depth map, once image and map are known to agree."""
        planes = depth_maps(image, depth, floating(self.dtype), device_named(self.device))
        height, width = planes.shape[1:]
        radius = self.signed_radius(planes[:, None])  # which looks at the sensor, too
        if width > self.sensor_res[0] or height > self.sensor_res[1]:
            raise ValueError(
                f"the image must lie within sensor_res={self.sensor_res} (W, H), got "
                f"{(width, height)}; make the lens with the image's sensor_res"
            )
        return radius


def _fitted(radius: Tensor, ks: int, aperture: Aperture, part: Part) -> Tensor:
    """The kernel of each radius, refused where it would be cut off."""
    ks = whole("ks", ks, "it is in px, 64 by default")
    diameters = 2 * radius.detach().abs()
    if bool((diameters > ks * (1 + 1e-6)).any()):  # what rounding adds is no reason to refuse
        widest = diameters.max()
        raise ValueError(
            f"ks must hold the circle of confusion, {float(widest):.6g} px across, got {ks}; "
            f"use ks={float(widest.ceil()):.0f} or more"
        )
    return kernel(radius, ks, aperture, part)


def _three(psf: Tensor) -> Tensor:
    return torch.stack([psf, psf, psf], dim=-3)


def _checked(grid: tuple[int, int]) -> tuple[int, int]:
    """A grid of at least one row and one column."""
    try:
        rows, columns = grid
        return whole("rows", rows, ""), whole("columns", columns, "")
    except (TypeError, ValueError):
        raise ValueError(
            f"grid must be (rows, columns), whole numbers of at least 1 each, got {grid}; "
            "it is (5, 5) by default"
        ) from None
