"""DefocusLens: the thin lens with DeepLens' interface, its PSFs and its renderer.

Methods that take object-space z (`psf`, `coc`, `dof`, `refocus`) follow the optics habit z < 0 in
front of the lens; a positive depth means the same distance. Renderers take maps of planar depth,
positive, in mm or in the `depth_unit`; `render_rgbd_dp` takes negative ones, too. The response does
not vary over the image.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.point_spread import PsfLens
from defocus_core.renderer.render import render
from defocus_core.tensors.threads import graph_break
from defocus_core.tensors.validation import Scalar, depth_maps, described, floating, one_of

DEPTH_UNITS = {"mm": 1.0, "m": 1000.0}  # mm


class DefocusLens(PsfLens):
    """A thin lens that computes the blur of points and renders images with their depth."""

    def __init__(
        self,
        foclen: Scalar,
        fnum: Scalar,
        sensor_size: tuple[float, float] = (8.0, 8.0),
        sensor_res: tuple[int, int] = (2000, 2000),
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        *,
        aperture: Aperture | None = None,
        depth_unit: str = "mm",
    ) -> None:
        """Set the lens and the sensor, as `ThinLens` does, and the opening.

        Args:
            foclen: Focal length in mm, > 0, or one for each picture [B].
            fnum: F-number, > 0, or one for each picture [B].
            sensor_size: (width, height) in mm.
            sensor_res: (width, height) in px.
            device: As for `ThinLens`.
            dtype: As for `ThinLens`.
            aperture: The opening in all renderings; None for the one that the psf_type of a call
                gives.
            depth_unit: "mm" or "m", the unit of the depth maps of `render_rgbd`, `render_rgbd_dp`
                and `signed_radius`; all other lengths are in mm.

        Raises:
            ValueError: As `ThinLens`, or if `aperture` is no Aperture.
        """
        super().__init__(foclen, fnum, sensor_size, sensor_res, device, dtype)
        if not isinstance(aperture, Aperture | None):
            problem = f"aperture must be an Aperture, got {described(aperture)}"
            raise ValueError(f"{problem}; a picture of it is Aperture(image=…)")
        self.aperture = aperture
        self._told_of_unit = False  # that its depths may be metres
        self.depth_unit = one_of("depth_unit", depth_unit, tuple(DEPTH_UNITS))

    def signed_radius(self, depth: Scalar) -> Tensor:
        """Signed CoC radius in px of a depth in the `depth_unit`; otherwise as in `ThinLens`."""
        return super().signed_radius(self._tensor("depth", depth) * DEPTH_UNITS[self.depth_unit])

    @graph_break
    def render_rgbd(
        self,
        img_obj: Tensor,
        depth_map: Tensor,
        psf_ks: int | None = None,
        num_layers: int | None = None,
        psf_type: str = "pillbox",
        depth_repair: str = "auto",
    ) -> Tensor:
        """The defocused image, from an all-in-focus image and its depth.

        Args:
            img_obj: [B, C, H, W], scene-linear, at most as large as sensor_res.
            depth_map: [B, 1, H, W] or [B, H, W], planar depth, > 0, inf for the sky.
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
            aperture=self._opening(psf_type),
            num_layers=num_layers,
            psf_ks=psf_ks,
            infinity=self.radii_at_infinity(),
            depth_repair=depth_repair,
        ).render

    @graph_break
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
            depth: As `render_rgbd`'s depth_map; or negative throughout, -inf for the sky.
            psf_ks: As for `render_rgbd`.
            num_layers: As for `render_rgbd`.
            psf_type: As for `render_rgbd`.
            depth_repair: As for `render`.

        Returns:
            (left, right), each [B, C, H, W].

        Raises:
            ValueError: As `render_rgbd`; depths of both signs in one map count as not positive.
        """
        rendering = render(
            rgb_img,
            self._image_radius(rgb_img, depth, either_sign=True),
            aperture=self._opening(psf_type),
            left_right=True,
            num_layers=num_layers,
            psf_ks=psf_ks,
            infinity=self.radii_at_infinity(),
            depth_repair=depth_repair,
        )
        assert rendering.left is not None
        assert rendering.right is not None
        return rendering.left, rendering.right

    def _opening(self, psf_type: str) -> Aperture:
        if self.aperture is None:
            return Aperture(psf_type=psf_type)
        if psf_type != "pillbox":
            problem = f"psf_type must be left out beside the aperture of the lens, got {psf_type!r}"
            raise ValueError(f"{problem}; give Aperture(psf_type=…)")
        return self.aperture

    def _image_radius(self, image: Tensor, depth: Tensor, *, either_sign: bool = False) -> Tensor:
        """Signed radii [B, 1, H, W] px of a depth map, which is checked to fit the image.

        `either_sign`: whether depth may also be negative throughout.
        """
        planes = depth_maps(image, depth, floating(self.dtype), image.device)
        if either_sign and bool((planes < 0).all()):
            planes = -planes
        finite = planes.detach()[planes.isfinite()] * DEPTH_UNITS[self.depth_unit]
        shortest = min(torch.as_tensor(self.foclen, device="cpu").detach().flatten().tolist())
        if len(finite) and float(finite.max()) <= shortest and not self._told_of_unit:
            self._told_of_unit = True
            problem = f"depth of at most {float(finite.max()):g} mm is within the focal length"
            remedy = 'say DefocusLens(…, depth_unit="m") if these are metres'
            warnings.warn(f"{problem}; {remedy}", UserWarning, stacklevel=4)
        height, width = planes.shape[1:]
        radius = self.signed_radius(planes[:, None])  # which looks at the sensor, too
        if width > self.sensor_res[0] or height > self.sensor_res[1]:
            raise ValueError(
                f"the image must lie within sensor_res={self.sensor_res} (W, H), got "
                f"{(width, height)}; make the lens with the image's sensor_res"
            )
        return radius
