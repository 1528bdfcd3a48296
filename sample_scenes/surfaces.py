"""Surfaces that a ray meets at most once: planes, spheres, small lights.

World: metres, x right, y down, z forward along the optical axis, the pinhole at the origin. The
direction of every ray has z = 1, so its parameter is the planar depth. Surfaces emit light that
does not depend on the direction of view.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating[Any]]
Bools = npt.NDArray[np.bool_]
Vector = tuple[float, float, float]
Texture = Callable[[Array, Array], Array]  # two coordinates -> linear RGB [..., 3]
Cutout = Callable[[Array, Array], Bools]  # two coordinates -> is there material?


class Rays(NamedTuple):
    """Rays (ox + z dx, oy + z dy, z); the four arrays broadcast together."""

    ox: Any
    oy: Any
    dx: Any
    dy: Any


class Surface(ABC):
    """Something a ray meets at most once."""

    @abstractmethod
    def hit(self, ray: Rays) -> Array:
        """Depth of the intersection, inf where there is none."""

    @abstractmethod
    def radiance(self, x: Array, y: Array, z: Array) -> Array:
        """Linear RGB [..., 3] at points of the surface."""

    @abstractmethod
    def corners(self) -> Array | None:
        """Points [n, 3] whose convex hull holds the surface, or None if it is infinite."""


@dataclass(frozen=True, eq=False)
class Plane(Surface):
    """Plane through `origin` along the unit vectors `right` and `down`, coordinates in metres.

    `half` cuts it to a rectangle of that half width and half height, `cutout` to any shape inside.
    """

    origin: Vector
    texture: Texture
    right: Vector = (1.0, 0.0, 0.0)
    down: Vector = (0.0, 1.0, 0.0)
    half: tuple[float, float] | None = None
    cutout: Cutout | None = None

    def coordinates(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Coordinates in the plane of world points."""
        (a, b, c), (ox, oy, oz) = self.right, self.origin
        d, e, f = self.down
        x, y, z = x - ox, y - oy, z - oz
        return a * x + b * y + c * z, d * x + e * y + f * z

    def hit(self, ray: Rays) -> Array:
        """Depth of the intersection, inf where there is none."""
        nx, ny, nz = np.cross(self.right, self.down)
        ox, oy, oz = self.origin
        facing = nx * ray.dx + ny * ray.dy + nz
        with np.errstate(divide="ignore"):
            z = (nx * (ox - ray.ox) + ny * (oy - ray.oy) + nz * oz) / facing
        z = np.where(z > 0, z, np.inf)
        if self.half is None and self.cutout is None:
            return z
        met = np.where(np.isfinite(z), z, 0.0)
        u, v = self.coordinates(ray.ox + met * ray.dx, ray.oy + met * ray.dy, met)
        inside = np.isfinite(z)
        if self.half is not None:
            inside &= (np.abs(u) <= self.half[0]) & (np.abs(v) <= self.half[1])
        if self.cutout is not None:
            inside &= self.cutout(u, v)
        return np.where(inside, z, np.inf)

    def radiance(self, x: Array, y: Array, z: Array) -> Array:
        """The texture at points of the plane."""
        return self.texture(*self.coordinates(x, y, z))

    def corners(self) -> Array | None:
        """The corners of the rectangle."""
        if self.half is None:
            return None
        steps = np.array([(i, j) for i in (-1, 1) for j in (-1, 1)]) * self.half
        return np.asarray(self.origin + steps @ np.array([self.right, self.down]))


@dataclass(frozen=True, eq=False)
class Sphere(Surface):
    """Sphere whose texture is a function of the outward unit normal."""

    centre: Vector
    radius: float
    texture: Callable[[Array, Array, Array], Array]

    def hit(self, ray: Rays) -> Array:
        """Depth of the near side, inf where there is none."""
        cx, cy, cz = self.centre
        x, y = ray.ox - cx, ray.oy - cy
        a = ray.dx**2 + ray.dy**2 + 1.0
        b = x * ray.dx + y * ray.dy - cz
        c = x * x + y * y + cz * cz - self.radius**2
        square = b * b - a * c
        z = (-b - np.sqrt(np.maximum(square, 0.0))) / a
        return np.where((square > 0) & (z > 0), z, np.inf)

    def radiance(self, x: Array, y: Array, z: Array) -> Array:
        """The texture at points of the sphere."""
        cx, cy, cz = self.centre
        R = self.radius
        return self.texture((x - cx) / R, (y - cy) / R, (z - cz) / R)

    def corners(self) -> Array | None:
        """The corners of the cube around it."""
        signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        return np.array(self.centre) + self.radius * signs


@dataclass(frozen=True, eq=False)
class Light(Surface):
    """Disc facing the camera; its radiance is added by `light_picture`, rays only find it dark."""

    centre: Vector
    radius: float
    emission: Vector

    def hit(self, ray: Rays) -> Array:
        """Depth of the disc, inf beside it."""
        cx, cy, cz = self.centre
        off = (ray.ox + cz * ray.dx - cx) ** 2 + (ray.oy + cz * ray.dy - cy) ** 2
        return np.where(off <= self.radius**2, cz, np.inf)

    def radiance(self, x: Array, y: Array, z: Array) -> Array:
        """Nothing: `light_picture` adds the emission."""
        return np.zeros((*x.shape, 3))

    def corners(self) -> Array | None:
        """The corners of the square around it."""
        steps = np.array([(i, j, 0) for i in (-1, 1) for j in (-1, 1)])
        return np.array(self.centre) + self.radius * steps


@dataclass(frozen=True)
class Scene:
    """Surfaces in any order; `sky` gives linear RGB for a direction (dx, dy, 1), None if closed."""

    surfaces: list[Surface]
    sky: Texture | None = None
    lights: list[Light] = field(default_factory=list)

    @property
    def everything(self) -> list[Surface]:
        """All surfaces and lights, which can stop a ray."""
        return [*self.surfaces, *self.lights]
