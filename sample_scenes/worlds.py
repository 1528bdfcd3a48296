"""The sample scenes: what stands before the camera, and how each is photographed."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from surfaces import Array, Bools, Cutout, Light, Plane, Scene, Sphere, Surface, Texture, Vector
from textures import (
    Paint,
    bricks,
    chance,
    checker,
    dots,
    framed,
    lettered,
    mix,
    noise,
    paint,
    plain,
    planks,
    rings,
    smooth,
    stripes,
    text,
)
from tracer import Camera


@dataclass(frozen=True)
class World:
    """A scene, its camera, focus in metres and f-number.

    `layers` asks for the second surface, `estimated` for depth as a network gives it.
    """

    scene: Scene
    camera: Camera
    focus: float
    fnum: float
    layers: bool = False
    estimated: bool = False


def turned(degrees: float) -> tuple[Vector, Vector]:
    """Right and down of a plane that faces the camera, turned clockwise in its own plane."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (c, s, 0.0), (-s, c, 0.0)


def ground(height: float, pitch: float, texture: Texture) -> Plane:
    """Horizontal floor `height` metres under a camera that looks down by `pitch` degrees.

    Texture coordinates are metres to the right and metres away along the floor.
    """
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    return Plane((0.0, height * c, height * s), texture, down=(0.0, -s, c))


def floor() -> World:
    """A wooden deck with painted distances, from 1 m to the horizon under an evening sky."""
    wood = planks(0.14, 1.9, paint(0x6B4630), paint(0xC79A6B))
    marks = {1.2: "1.2", 1.6: "1.6", 2.2: "2.2", 3.2: "3.2", 5.0: "5", 8.0: "8"}
    pitch = 6.0

    def deck(u: Array, v: Array) -> Array:
        colour = wood(u, v)
        for distance, number in marks.items():
            size = 0.075 * distance
            # letters stretched away from the camera, as on roads, read well at a low angle
            letters = text(u, (distance * 1.14 - v) / 2.6, number, size)
            line = (np.abs(v - distance) < 0.008 * distance) & (np.abs(u) < 0.28 * distance)
            colour = mix(letters | line, colour, paint(0xF4EBD8))
        return mix(smooth(v, 4.0, 60.0), colour, paint(0xB0968A))

    def evening(dx: Array, dy: Array) -> Array:
        horizon = -math.tan(math.radians(pitch))
        up = horizon - dy
        sky = mix(smooth(up, 0.0, 0.11), paint(0xFFD9A0), paint(0x6F8FC0))
        sun = np.exp(-((dx - 0.17) ** 2 + (up - 0.035) ** 2) / 0.0009)
        sky = sky + 2.5 * sun[..., None] * np.asarray(paint(0xFFC070))
        hills = 0.012 + 0.02 * noise(dx * 9, 0 * dx, 1) + 0.006 * noise(dx * 40, 0 * dx, 2)
        return mix(up < hills, sky, paint(0x6C6A86))

    return World(Scene([ground(0.34, pitch, deck)], evening), Camera(), 1.6, 0.95)


def leaf(place: Vector, length: float, angle: float, tilt: float, tone: float) -> Plane:
    """A leaf with its tip to the right, turned by `angle`, its tip nearer by `tilt` degrees."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    ct, st = math.cos(math.radians(tilt)), math.sin(math.radians(tilt))
    width = 0.36 * length

    def outline(u: Array, v: Array) -> Bools:
        t = np.clip(u / length + 0.5, 0.0, 1.0)
        return np.asarray(np.abs(v) < width * 1.9 * t**0.7 * (1 - t))

    def surface(u: Array, v: Array) -> Array:
        vein = (u - 1.1 * np.abs(v)) / length * 9 % 1
        green = mix(tone + 0.25 * v / width, paint(0x2F6B2A), paint(0x9CC24A))
        green = mix(0.35 * (vein < 0.16), green, paint(0xD8E8A0))
        return mix(np.abs(v) < 0.018 * length, green, paint(0xD8E8A0))

    return Plane(place, surface, (c * ct, s * ct, -st), (-s, c, 0.0), (length / 2, width), outline)


def twig(start: tuple[float, float], stop: tuple[float, float], z: float, width: float) -> Plane:
    """A straight twig between two points at depth z."""
    (x0, y0), (x1, y1) = start, stop
    angle, length = math.degrees(math.atan2(y1 - y0, x1 - x0)), math.hypot(x1 - x0, y1 - y0)
    middle = ((x0 + x1) / 2, (y0 + y1) / 2, z)
    return Plane(middle, plain(paint(0x4A3524)), *turned(angle), half=(length / 2, width / 2))


def leaves() -> World:
    """Leaves and twigs close to the lens before a sharp brick wall with a poster."""
    camera = Camera(foclen=85.0)
    wall = bricks(0.21, 0.075, paint(0x8A4B38), paint(0xC98A68), paint(0xD9CFC0))
    half = (0.33, 0.24)
    paper, ink = plain(paint(0xF3E6C4)), paint(0x1F4E6B)
    poster = framed(half, 0.018, lettered("NEAR\nAND FAR", 0.085, paper, ink), ink)
    surfaces: list[Surface] = [
        Plane((0.0, 0.0, 4.0), wall),
        Plane((0.10, -0.03, 3.97), poster, *turned(-3.0), half=half),
    ]
    branches = [((-0.25, -0.02), (0.02, -0.13), 1.05), ((0.06, 0.16), (0.27, 0.02), 1.12)]
    branches += [((-0.28, 0.16), (-0.05, 0.10), 0.98), ((-0.12, -0.16), (0.24, -0.085), 1.25)]
    for number, (start, stop, z) in enumerate(branches):
        surfaces.append(twig(start, stop, z, 0.0032))
        for k in range(7):
            t, side = (k + 0.6) / 7, 1 if k % 2 else -1
            luck = [float(chance(np.array(number), np.array(k), seed)) for seed in range(4)]
            angle = math.degrees(math.atan2(stop[1] - start[1], stop[0] - start[0]))
            angle += side * (38 + 30 * luck[0])
            length = 0.042 + 0.026 * luck[1]
            reach, way = 0.5 * length, math.radians(angle)
            x = start[0] + t * (stop[0] - start[0]) + reach * math.cos(way)
            y = start[1] + t * (stop[1] - start[1]) + reach * math.sin(way)
            place = (x, y, z - 0.01 - 0.03 * luck[2])
            surfaces.append(leaf(place, length, angle, 50 * luck[3] - 25, 0.25 + 0.5 * luck[2]))
    return World(Scene(surfaces), camera, 4.0, 3.0)


def layered() -> World:
    """Poster cards on both sides of the focus, overlapping, before a papered wall."""
    cream, ink = paint(0xF2E8CF), paint(0x22333B)
    red, blue, green = paint(0xC8553D), paint(0x2E6F95), paint(0x588157)
    ochre, rose = paint(0xE0A030), paint(0xE5B8A5)
    label = lettered("FOCUS\nF/2.0", 0.06, plain(cream), red)
    wallpaper = dots(0.22, paint(0x8FA9A3), paint(0xC9D6CF))

    def card(
        x: float, y: float, z: float, size: tuple[float, float], angle: float, art: Texture,
        frame: Paint = cream, cutout: Cutout | None = None,
    ) -> Plane:  # fmt: skip
        half = (size[0] * z / 2, size[1] * z / 2)
        edged = framed(half, 0.012 * z, art, frame)
        return Plane((x * z, y * z, z), edged, *turned(angle), half=half, cutout=cutout)

    surfaces: list[Surface] = [
        Plane((0.0, 0.0, 6.0), wallpaper),
        card(-0.20, -0.06, 4.2, (0.22, 0.25), -7, rings(0.16, blue, paint(0xBFD7EA))),
        card(0.23, -0.07, 3.3, (0.20, 0.22), 8, stripes(0.12, 45, ochre, cream), ink),
        card(0.03, -0.03, 2.4, (0.20, 0.24), -2, checker(0.07, green, paint(0xDAD7A0))),
        card(-0.07, 0.04, 2.0, (0.21, 0.17), 4, label, red),
        card(0.16, 0.07, 1.6, (0.16, 0.15), -9, dots(0.035, rose, red), cream),
        card(-0.26, 0.12, 1.35, (0.17, 0.14), 12, stripes(0.03, 0, ink, cream), ochre),
        card(0.31, 0.13, 1.15, (0.15, 0.16), 5, checker(0.028, blue, cream), ink,
             lambda u, v: np.hypot(u, v) > 0.045),
    ]  # fmt: skip
    return World(Scene(surfaces), Camera(foclen=150.0, sensor_width=108.0), 2.0, 2.0, layers=True)


def shaded(art: Callable[[Array, Array, Array], Array]) -> Callable[[Array, Array, Array], Array]:
    """Light from the upper left, baked into a sphere's texture."""
    sun = np.array([-0.55, -0.65, -0.53])

    def texture(x: Array, y: Array, z: Array) -> Array:
        lit = np.maximum(x * sun[0] + y * sun[1] + z * sun[2], 0.0)
        fill = 0.22 + 0.10 * (-y) + 0.06 * np.maximum(y, 0)
        shine = 0.9 * np.maximum(lit, 0.0) ** 40
        return np.asarray(art(x, y, z) * (fill + 0.95 * lit)[..., None] + shine[..., None])

    return texture


def spheres() -> World:
    """Painted balls on a chequered table, with baked light and soft shadows."""
    cream = paint(0xF0E6D2)

    def beach(colour: Paint, count: int, turn: float) -> Callable[[Array, Array, Array], Array]:
        def art(x: Array, y: Array, z: Array) -> Array:
            c, s = math.cos(turn), math.sin(turn)
            around = np.arctan2(z, c * x + s * y) / (2 * math.pi)
            cap = np.abs(c * y - s * x) > 0.9
            return mix((np.floor(around * 2 * count) % 2 > 0) | cap, cream, colour)

        return shaded(art)

    def banded(colour: Paint, count: float, turn: float) -> Callable[[Array, Array, Array], Array]:
        def art(x: Array, y: Array, z: Array) -> Array:
            c, s = math.cos(turn), math.sin(turn)
            return mix(np.floor((c * y - s * x) * count) % 2, cream, colour)

        return shaded(art)

    pitch, height = 12.0, 0.42
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    balls = [
        (-0.21, 0.98, 0.085, banded(paint(0xC8553D), 4.0, 0.5)),
        (0.22, 1.22, 0.075, beach(paint(0x2E6F95), 5, 0.3)),
        (-0.02, 1.62, 0.12, beach(paint(0xD9902F), 6, -0.4)),
        (0.45, 1.95, 0.11, banded(paint(0x588157), 3.0, -0.7)),
        (-0.50, 2.25, 0.15, banded(paint(0x6D597A), 5.0, 0.2)),
        (0.14, 2.75, 0.14, beach(paint(0xB23A48), 4, 0.8)),
        (0.86, 3.2, 0.17, beach(paint(0x3A7D7C), 7, 0.1)),
        (-0.30, 3.6, 0.18, banded(paint(0xE0A030), 3.5, -0.2)),
    ]
    tiles = checker(0.16, paint(0x9A8F80), paint(0xD8CFC0))

    def table(u: Array, v: Array) -> Array:
        light = np.ones_like(u)
        for x, away, radius, _ in balls:
            # the shadow of the sun: an ellipse away from the light, darkest under the ball
            du, dv = (u - x) / radius, (v - away) / radius
            along, across = 0.72 * du + 0.69 * dv, -0.69 * du + 0.72 * dv
            far = np.hypot((along - 0.75) / 1.5, across)
            light *= 1 - 0.55 * (1 - smooth(far, 0.65, 1.15))
            light *= 1 - 0.55 * np.exp(-(du**2 + dv**2) / 0.35)
        return np.asarray(tiles(u, v) * light[..., None] * np.array([0.95, 0.93, 0.9]))

    def wall(u: Array, v: Array) -> Array:
        panel = stripes(0.5, 0, paint(0x58707A), paint(0x637D87))(u, v)
        return np.asarray(panel * (0.75 + 0.25 * smooth(-v, -1.0, 1.5))[..., None])

    surfaces: list[Surface] = [
        ground(height, pitch, table),
        Plane((0.0, 0.0, 5.2), wall, down=(0.0, c, s)),
    ]
    for x, away, radius, art in balls:
        up = height - radius
        centre = (x, up * c - away * s, up * s + away * c)
        surfaces.append(Sphere(centre, radius, art))
    return World(Scene(surfaces), Camera(foclen=75.0, sensor_width=54.0), 1.6, 1.2, estimated=True)


def lights() -> World:
    """A city at night behind a wire fence: lights of radiance 50 to 2000 and a lamp-lit sign."""
    camera = Camera(foclen=85.0)
    F, far, road_height = camera.focal_px, 40.0, 1.5

    def town(u: Array, v: Array) -> Array:
        sky = mix(smooth(-v, -1.0, 7.5), paint(0x7A4A5A), paint(0x0E1730))
        house = np.floor(u / 2.3)
        top = 0.6 + 4.2 * chance(house, 0 * house, 3)
        wall = mix(chance(house, 0 * house, 4), paint(0x12161F), paint(0x272A36))
        i, j = np.floor(u / 0.46), np.floor(v / 0.62)
        pane = (np.abs(u / 0.46 - i - 0.5) < 0.3) & (np.abs(v / 0.62 - j - 0.5) < 0.32)
        lamp = pane & (chance(i, j, 6) > 0.62) & (v > 0.35 - top)
        glow = mix(chance(i, j, 7), paint(0xE08A30), paint(0xFFE6A8))
        building = mix(lamp, wall, glow)
        return mix(v > -top, sky, building)

    def road(u: Array, v: Array) -> Array:
        wet = mix(smooth(v, 3.0, 40.0), paint(0x15181E), paint(0x3A3440))
        dashes = (np.abs(u + 0.5) < 0.09) & (v % 3.0 < 1.6)
        kerb = np.abs(np.abs(u + 0.5) - 3.2) < 0.07
        return mix(dashes | kerb, wet, paint(0x8C8A80))

    def fence(u: Array, v: Array) -> Bools:
        a, b = (u + 0.62 * v) / 0.11, (u - 0.62 * v) / 0.11
        wire = 0.014
        return (np.abs(a - np.round(a)) < wire) | (np.abs(b - np.round(b)) < wire)

    half = (0.125, 0.085)
    blue, white = paint(0x1B4E8C), paint(0xF6F1E0)
    sign = framed(half, 0.009, lettered("NIGHT\nBUS 36", 0.04, plain(blue), white), white)
    surfaces: list[Surface] = [
        Plane((0.0, 0.0, far), town),
        ground(road_height, 0.0, road),
        Plane((0.26, -0.08, 2.0), sign, half=half),
        Plane((0.26, 0.20, 2.02), plain(paint(0x50545C)), half=(0.008, 0.40)),
        Plane((0.0, 0.0, 1.55), stripes(0.004, 50, paint(0x5A6068), paint(0x9AA0A8)), cutout=fence),
    ]
    amber, warm, cold = (1.0, 0.62, 0.25), (1.0, 0.86, 0.62), (0.9, 0.95, 1.0)
    red, green = (1.0, 0.16, 0.08), (0.2, 1.0, 0.45)
    spots: list[tuple[float, float, float, float, Paint]] = [  # column, row, radius px, radiance
        (18, 60, 0.9, 50, warm), (38, 118, 1.0, 220, amber), (72, 66, 0.7, 900, cold),
        (104, 132, 1.2, 120, warm), (131, 40, 0.6, 2000, warm), (150, 121, 0.9, 300, red),
        (176, 97, 0.8, 250, amber), (203, 136, 1.1, 160, green), (228, 58, 0.7, 600, amber),
        (247, 126, 1.0, 260, warm), (262, 88, 0.6, 420, cold), (283, 141, 0.9, 330, red),
        (303, 33, 0.5, 1500, cold), (330, 30, 0.8, 240, amber), (421, 27, 0.7, 600, amber),
        (473, 84, 0.9, 200, warm), (352, 154, 1.0, 180, amber), (433, 150, 1.3, 70, green),
        (58, 186, 0.8, 380, cold), (76, 186, 0.8, 380, cold), (215, 178, 0.7, 330, red),
        (227, 178, 0.7, 330, red), (262, 196, 0.8, 260, red), (283, 196, 0.8, 260, red),
    ]  # fmt: skip
    lamps = []
    for column, row, size, radiance, tint in spots:
        down = (row + 0.5 - camera.height / 2) / F
        # just before what the pinhole sees behind the lamp, whose rim shares pixels with it
        z = min(far, road_height / down if down > 0 else far) * 0.98
        place = ((column + 0.5 - camera.width / 2) / F * z, down * z, z)
        r, g, b = (radiance * c for c in tint)
        lamps.append(Light(place, size * z / F, (r, g, b)))
    return World(Scene(surfaces, lights=lamps), camera, 2.0, 1.75)


WORLDS: dict[str, Callable[[], World]] = {
    "floor": floor,
    "layered": layered,
    "leaves": leaves,
    "lights": lights,
    "spheres": spheres,
}
