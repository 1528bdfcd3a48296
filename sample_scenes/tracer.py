"""Thin-lens photographs of textured surfaces, ray by ray.

Pixel i covers [i, i + 1), the principal point is the middle of the picture. Lens points u lie in
the unit disc, x right, y down, seen from behind the camera. A point that the pinhole sees at pixel
q is seen through u at q + r u, r the signed CoC radius in px: `rays` has exactly this property.
Radiance does not depend on the direction of view, so a picture is the mean of off-axis pinhole
views.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from surfaces import Array, Bools, Light, Rays, Scene, Surface


@dataclass(frozen=True)
class Camera:
    """Size of the picture in px, sensor and focal length in mm."""

    width: int = 480
    height: int = 270
    foclen: float = 50.0
    sensor_width: float = 36.0

    @property
    def focal_px(self) -> float:
        """Pinhole focal length in px."""
        return self.width * self.foclen / self.sensor_width


@dataclass(frozen=True)
class Lens:
    """Focus in metres and the signed CoC radius of infinity in px; 0 is a pinhole."""

    focus: float
    radius_at_infinity: float

    def signed_radius(self, z: float | Array) -> Any:
        """Signed CoC radius in px at depth z, affine in 1/z."""
        return self.radius_at_infinity * (1.0 - self.focus / z)


PINHOLE = Lens(1.0, 0.0)


def thin_lens(camera: Camera, fnum: float, focus: float) -> Lens:
    """Lens of `camera` with f-number `fnum`, focused at `focus` metres: c = A v (1/s - 1/z)."""
    f, s = camera.foclen, 1000.0 * focus
    pitch = camera.sensor_width / camera.width
    return Lens(focus, f * f / (2.0 * fnum * (s - f) * pitch))


def rays(camera: Camera, lens: Lens, x: Array, y: Array, ux: Any, uy: Any) -> Rays:
    """Rays that reach image point (x, y), in px, through lens point (ux, uy)."""
    F, R = camera.focal_px, lens.radius_at_infinity
    return Rays(
        R * lens.focus / F * ux,
        R * lens.focus / F * uy,
        (x - camera.width / 2 - R * ux) / F,
        (y - camera.height / 2 - R * uy) / F,
    )


class View(NamedTuple):
    """The view of a lens point: linear RGB [H, W, 3], depth [H, W], and where a surface is."""

    rgb: Array
    depth: Array
    seen: Bools


def view(
    scene: Scene,
    camera: Camera,
    lens: Lens,
    point: tuple[float, float] = (0.0, 0.0),
    offset: tuple[float, float] = (0.5, 0.5),
    behind: Array | None = None,
) -> View:
    """Off-axis pinhole view through lens point `point`, sampled at `offset` inside each pixel.

    Surfaces count only where they are deeper than `behind` [H, W]: depth peeling. Behind an
    infinite depth there is nothing.
    """
    H, W = camera.height, camera.width
    x, y = np.arange(W)[None, :] + offset[0], np.arange(H)[:, None] + offset[1]
    ray = rays(camera, lens, x, y, *point)
    depth, index = np.full((H, W), np.inf), np.full((H, W), -1)
    everything = scene.everything
    for number, surface in enumerate(everything):
        rows, cols = _window(surface, camera, lens, point)
        if rows.start >= rows.stop or cols.start >= cols.stop:
            continue
        z = surface.hit(Rays(ray.ox, ray.oy, ray.dx[:, cols], ray.dy[rows]))
        nearer = z < depth[rows, cols]
        if behind is not None:
            nearer &= z > behind[rows, cols]
        np.copyto(depth[rows, cols], z, where=nearer)
        np.copyto(index[rows, cols], number, where=nearer)
    rgb, seen = np.zeros((H, W, 3)), index >= 0
    for number in np.unique(index[seen]):
        i, j = np.nonzero(index == number)
        z = depth[i, j]
        at = (ray.ox + z * ray.dx[0, j], ray.oy + z * ray.dy[i, 0], z)
        rgb[i, j] = everything[number].radiance(*at)
    if scene.sky is not None:
        open_sky = ~seen if behind is None else ~seen & np.isfinite(behind)
        i, j = np.nonzero(open_sky)
        rgb[i, j] = scene.sky(ray.dx[0, j], ray.dy[i, 0])
        seen = seen | open_sky
    return View(rgb, depth, seen)


def _window(
    surface: Surface, camera: Camera, lens: Lens, point: tuple[float, float]
) -> tuple[slice, slice]:
    """Rows and columns that can see the surface through a lens point."""
    corners = surface.corners()
    if corners is None or corners[:, 2].min() <= 0:
        return slice(0, camera.height), slice(0, camera.width)
    x, y, z = corners.T
    r = lens.signed_radius(z)
    column = camera.width / 2 + camera.focal_px * x / z + r * point[0]
    row = camera.height / 2 + camera.focal_px * y / z + r * point[1]

    def span(values: Array, size: int) -> slice:
        # one pixel of margin, because samples lie anywhere inside their pixel
        first, last = math.floor(values.min()) - 1, math.ceil(values.max()) + 1
        return slice(max(first, 0), min(last, size))

    return span(row, camera.height), span(column, camera.width)


def sobol(dimensions: int, samples: int, seed: int) -> Array:
    """Scrambled Sobol points [samples, dimensions] in the unit cube."""
    engine = torch.quasirandom.SobolEngine(dimensions, scramble=True, seed=seed)  # type: ignore[no-untyped-call]
    return np.asarray(engine.draw(samples).double().numpy())


def disc(a: Array, b: Array) -> tuple[Array, Array]:
    """Square to unit disc, area preserving (Shirley and Chiu 1997); a < 1/2 is the half x < 0."""
    x, y = 2 * a - 1, 2 * b - 1
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(wide, math.pi / 4 * (y / x), math.pi / 2 - math.pi / 4 * (x / y))
    return radius * np.cos(angle), radius * np.sin(angle)


class Pair(NamedTuple):
    """Pictures [H, W, 3] through the lens halves x < 0 and x >= 0, each normalised by its area."""

    left: Array
    right: Array

    @property
    def full(self) -> Array:
        """Picture through the whole lens."""
        return (self.left + self.right) / 2


def photograph(
    scene: Scene,
    camera: Camera,
    lens: Lens,
    *,
    samples: int,
    seed: int,
    light_samples: int = 1024,
    tick: Callable[[], object] = lambda: None,
) -> Pair:
    """Mean over the pixel and the lens, lights included; `tick` is called after each view.

    `samples` must be a power of two: then exactly half of the Sobol points lie in each half of
    the lens.
    """
    halves = np.zeros((2, camera.height, camera.width, 3))
    points = sobol(4, samples, seed)
    ux, uy = disc(points[:, 0], points[:, 1])
    for k in range(samples):
        seen = view(scene, camera, lens, (ux[k], uy[k]), (points[k, 2], points[k, 3]))
        halves[int(points[k, 0] >= 0.5)] += seen.rgb / (samples / 2)
        tick()
    for number, light in enumerate(scene.lights):
        halves += light_picture(scene, light, camera, lens, light_samples, seed + 1 + number)
    return Pair(*halves)


def light_picture(
    scene: Scene, light: Light, camera: Camera, lens: Lens, samples: int, seed: int
) -> Array:
    """The light alone [2, H, W, 3], in the left and the right picture, free of fireflies.

    A pixel point x and an emitter point e fix the lens point u = (x - e) / r. With du = de / r² the
    mean over the lens, (1/π) ∫ L du, becomes L area / (π r²) times the share of pairs (x, e) whose
    u lies in the disc and sees the light.
    """
    cx, cy, cz = light.centre
    F, r = camera.focal_px, float(lens.signed_radius(cz))
    size = light.radius * F / cz
    if 0 < abs(r) < size:
        raise ValueError(
            f"light at {light.centre}: CoC radius {r:.2f} px is below its own {size:.2f} px; "
            "move it out of focus"
        )
    qx, qy = camera.width / 2 + F * cx / cz, camera.height / 2 + F * cy / cz
    rows = _pixels(qy, abs(r) + size, camera.height)
    cols = _pixels(qx, abs(r) + size, camera.width)
    points = sobol(4, samples, seed)
    x = np.arange(cols.start, cols.stop)[None, :, None] + points[:, 0]
    y = np.arange(rows.start, rows.stop)[:, None, None] + points[:, 1]
    x, y = np.broadcast_arrays(x, y)  # [rows, columns, samples]
    if r == 0.0:
        ux = uy = np.zeros_like(x)
        share = np.hypot(x - qx, y - qy) <= size
        halves = [1.0 * share, 1.0 * share]
    else:
        ex, ey = disc(points[:, 2], points[:, 3])
        ux, uy = (x - qx - size * ex) / r, (y - qy - size * ey) / r
        share = ux**2 + uy**2 <= 1.0
        halves = [2.0 * (size / r) ** 2 * (share & half) for half in (ux < 0, ux >= 0)]
    ray = rays(camera, lens, x, y, ux, uy)
    clear = np.ones(x.shape, dtype=bool)
    for other in scene.everything:
        corners = other.corners()
        if other is not light and (corners is None or corners[:, 2].min() < cz):
            clear &= other.hit(ray) >= cz
    picture = np.zeros((2, camera.height, camera.width, 3))
    for half, amount in zip(picture, halves, strict=True):
        half[rows, cols] = (amount * clear).mean(-1)[..., None] * np.array(light.emission)
    return picture


def _pixels(middle: float, reach: float, size: int) -> slice:
    """Pixels within `reach` of `middle` that lie in the picture."""
    first, last = math.floor(middle - reach), math.floor(middle + reach) + 1
    return slice(min(max(first, 0), size), min(max(last, 0), size))
