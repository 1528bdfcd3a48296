"""Make the sample scenes: pictures, depth, camera and thin-lens truth, in the folder of this file.

    python sample_scenes/make.py [--only NAME] [--out DIR] [--samples 2048]

A folder per scene holds
  rgb.exr                pinhole picture, linear Rec. 709, half, mean over each pixel
  depth.exr              Z, float, planar metres at pixel centres, +inf = sky
  camera.json            size, sensor, focal length, and the shot: f-number and focus
  truth_<shot>.exr       the same through the thin lens; _left, _right: through half of it
  layer1_*.exr           `layered` only: the next surface behind the first
  estimated.png          `spheres` only: depth as a network gives it, made from depth.exr; its
                         range, for --depth-range, stands in camera.json
  stats.json             noise of each picture, from two independent halves of the samples

The field of view stays that of the pinhole, focal_length · width / sensor_width px, at any focus.
The same machine and versions write the same bytes. Three bits of the halves, and eight of the
depths, are rounded away: an error of at most 0.2 %, and files a third smaller.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
from estimated import estimated
from surfaces import Array, Scene
from tqdm import tqdm
from tracer import PINHOLE, Camera, Lens, Pair, photograph, sobol, thin_lens, view
from worlds import WORLDS, World

SEEDS = (20, 1020)  # of the two halves of the samples
PINHOLE_SAMPLES, LAYER_SAMPLES, LIGHT_SAMPLES = 256, 64, 2048


def rounded(values: Array, bits: int) -> Array:
    """Float values with `bits` significant bits; 0 and inf stay."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, bits)), exponent - bits))


def write_exr(path: Path, channels: dict[str, Array]) -> None:
    """Write a ZIP-compressed EXR; half or float follows the arrays."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {k: np.ascontiguousarray(v) for k, v in channels.items()}).write(str(path))


def write_picture(path: Path, rgb: Array) -> None:
    """Write linear RGB [H, W, 3] as half."""
    half = rounded(rgb, 8).astype(np.float16)
    write_exr(path, {name: half[..., k] for k, name in enumerate("RGB")})


def write_depth(path: Path, depth: Array) -> None:
    """Write planar depth [H, W] in metres as float."""
    write_exr(path, {"Z": rounded(depth, 16).astype(np.float32)})


def write_estimated(path: Path, depth: Array) -> list[float]:
    """Write depth [H, W] as a network estimates it; the depths of 255 and of 0, in metres."""
    levels, near, far = estimated(depth)
    height, width = levels.shape
    image = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, height, 1, OpenImageIO.UINT8))
    image.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(levels[:, :, None]))
    if not image.write(str(path)):
        sys.exit(f"make: {path}: {image.geterror()}")
    return [round(near, 4), round(far, 4)]


def exposed(
    world: World, lens: Lens, samples: int, light_samples: int
) -> tuple[Pair, dict[str, float]]:
    """Picture pair from two independent halves of the samples, and its relative noise."""
    with tqdm(total=samples, leave=False) as bar:
        a, b = (
            photograph(
                world.scene,
                world.camera,
                lens,
                samples=samples // 2,
                seed=seed,
                light_samples=light_samples // 2,
                tick=bar.update,
            )
            for seed in SEEDS
        )
    pair = Pair((a.left + b.left) / 2, (a.right + b.right) / 2)

    def noise(x: Array, y: Array) -> float:
        return float(f"{np.sqrt(np.mean((x - y) ** 2)) / 2 / np.mean((x + y) / 2):.3g}")

    names = ("noise_rel", "noise_rel_left", "noise_rel_right")
    couples = ((a.full, b.full), (a.left, b.left), (a.right, b.right))
    return pair, {name: noise(*couple) for name, couple in zip(names, couples, strict=True)}


def second_layer(scene: Scene, camera: Camera, samples: int) -> tuple[Array, Array]:
    """Linear RGB [H, W, 3] and depth [H, W] of what lies behind the first surface.

    RGB is the mean over the part of the pixel that has a second surface, 0 where its middle has
    none: 0 with infinite depth means nothing, anything else with infinite depth is sky.
    """
    size = (camera.height, camera.width)
    total, count = np.zeros((*size, 3)), np.zeros(size)
    for x, y in sobol(2, samples, SEEDS[0]):
        first = view(scene, camera, PINHOLE, offset=(x, y))
        second = view(scene, camera, PINHOLE, offset=(x, y), behind=first.depth)
        total += second.rgb
        count += second.seen
    first = view(scene, camera, PINHOLE)
    second = view(scene, camera, PINHOLE, behind=first.depth)
    return total / np.maximum(count, 1)[..., None] * second.seen[..., None], second.depth


def make(name: str, folder: Path, samples: int) -> None:
    """Render one scene into `folder`."""
    world = WORLDS[name]()
    camera, lens = world.camera, thin_lens(world.camera, world.fnum, world.focus)
    folder.mkdir(parents=True, exist_ok=True)
    depth = view(world.scene, camera, PINHOLE).depth
    write_depth(folder / "depth.exr", depth)
    radius = float(np.abs(lens.signed_radius(depth)).max())
    shot = f"r{radius:.0f}"
    details: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "sensor_width_mm": camera.sensor_width,
        "focal_length_mm": camera.foclen,
        "convention": "fov from f",
        "shots": [
            {
                "name": shot,
                "fnumber": world.fnum,
                "focus_distance_m": world.focus,
                "max_coc_radius_px": round(radius, 3),
                "aperture": "disk",
                "dual_pixel": True,
            }
        ],
    }
    if world.estimated:
        details["estimated_depth_range_m"] = write_estimated(folder / "estimated.png", depth)
    (folder / "camera.json").write_text(json.dumps(details, indent=1) + "\n")

    pinhole, noise = exposed(world, PINHOLE, PINHOLE_SAMPLES, 2 * LIGHT_SAMPLES)
    stats = {"rgb": {"samples": PINHOLE_SAMPLES, "noise_rel": noise["noise_rel"]}}
    write_picture(folder / "rgb.exr", pinhole.full)
    pair, noise = exposed(world, lens, samples, LIGHT_SAMPLES)
    stats[shot] = {"samples": samples, **noise}
    write_picture(folder / f"truth_{shot}.exr", pair.full)
    write_picture(folder / f"truth_{shot}_left.exr", pair.left)
    write_picture(folder / f"truth_{shot}_right.exr", pair.right)
    if world.layers:
        rgb, depth = second_layer(world.scene, camera, LAYER_SAMPLES)
        write_picture(folder / "layer1_rgb.exr", rgb)
        write_depth(folder / "layer1_depth.exr", depth)
    (folder / "stats.json").write_text(json.dumps(stats, indent=1) + "\n")


def main() -> None:
    """Parse the command line and make what it asks for."""
    parser = argparse.ArgumentParser(description="Make the sample scenes.")
    parser.add_argument("--only", choices=list(WORLDS), help="one scene instead of all")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder of folders")
    parser.add_argument("--samples", type=int, default=2048, help="lens samples, a power of two")
    options = parser.parse_args()
    for name in [options.only] if options.only else WORLDS:
        print(f"{name} …", file=sys.stderr)
        make(name, options.out / name, options.samples)


if __name__ == "__main__":
    main()
