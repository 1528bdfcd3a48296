"""Render every sample scene with `defocus render` and measure it against its thin-lens truth.

A scene with estimated.png, depth like that of networks, is rendered with this depth, too.

    python sample_scenes/demo.py [--out out] [-- OPTION …]      (options for `defocus render`)

PSNR is that of sRGB-encoded pictures, clipped to [0, 1]. A border as wide as the largest circle of
confusion is left out, since content outside the frame is not in the input.
"""

import argparse
import json
import math
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
from surfaces import Array

BEFORE_AFTER = ("lights", "spheres")
KINDS = {"render": "", "left": "_left", "right": "_right"}


def read_rgb(path: Path) -> Array:
    """Linear RGB [H, W, 3] of an EXR."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels.astype(np.float64) for name in "RGB"], -1)


def encoded(linear: Array) -> Array:
    """sRGB-encoded, clipped to [0, 1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.003) ** (1 / 2.4) - 0.055)


def psnr(picture: Array, truth: Array, border: int) -> float:
    """PSNR in dB of encoded pictures, without `border` px on each side."""
    inner = (slice(border, -border or None),) * 2
    error = float(np.mean((encoded(picture) - encoded(truth))[inner] ** 2))
    return -10 * math.log10(max(error, 1e-10))


def depths(scene: Path, camera: dict[str, Any]) -> dict[str, list[str]]:
    """Depth files of a scene, each with the options that read it, by the name of their rows."""
    rows = {scene.name: [str(scene / "depth.exr")]}
    if (scene / "estimated.png").exists():
        near, far = (f"{metres}m" for metres in camera["estimated_depth_range_m"])
        kind = ["--depth-kind", "disparity", "--depth-range", near, far]
        estimated = str(scene / "estimated.png")
        rows[f"{scene.name}*"] = [estimated, *kind, "--resize-depth", "guided"]
    return rows


def command(
    scene: Path, depth: list[str], camera: dict[str, Any], shot: dict[str, Any], out: Path
) -> list[str]:
    """The command line that renders a shot."""
    beside = Path(sys.executable).with_name("defocus")
    program = str(beside) if beside.exists() else shutil.which("defocus") or "defocus"
    settings = {
        "--focal-length": f"{camera['focal_length_mm']}mm",
        "--sensor-width": f"{camera['sensor_width_mm']}mm",
        "--fnumber": f"{shot['fnumber']}",
        "--focus": f"{shot['focus_distance_m']}m",
        "--outputs": "render,left,right,coc",
    }
    options = [word for pair in settings.items() for word in pair]
    files = [str(scene / "rgb.exr"), *depth, "-o", str(out)]
    return [program, "render", *files, *options, "--preview", "--overwrite"]


def contact_row(scene: Path, out: Path) -> Array:
    """Input, render, left, right and CoC beside each other, encoded [H, 5 W, 3]."""
    previews = [read_png(out / kind / "rgb.preview.png") for kind in (*KINDS, "coc")]
    return np.concatenate([encoded(read_rgb(scene / "rgb.exr")), *previews], 1)


def read_png(path: Path) -> Array:
    """Encoded picture [H, W, 3] from a PNG."""
    image = OpenImageIO.ImageBuf(str(path))
    pixels = image.get_pixels(OpenImageIO.FLOAT)
    if image.has_error or pixels is None:
        sys.exit(f"demo: {path}: {image.geterror()}")
    return np.asarray(pixels[..., :3])


def write_png(path: Path, rgb: Array) -> None:
    """Write an encoded picture [H, W, 3] as 8-bit PNG."""
    height, width, _ = rgb.shape
    image = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(width, height, 3, OpenImageIO.UINT8))
    image.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(rgb, dtype=np.float32))
    if not image.write(str(path)):
        sys.exit(f"demo: {path}: {image.geterror()}")


def line(name: str, scene: Path, shot: dict[str, Any], out: Path, seconds: float) -> str:
    """A row of the table: PSNR of the input and of each rendered kind."""
    border = math.ceil(shot["max_coc_radius_px"])
    truth = {k: read_rgb(scene / f"truth_{shot['name']}{v}.exr") for k, v in KINDS.items()}
    values = [psnr(read_rgb(scene / "rgb.exr"), truth["render"], border)]
    values += [psnr(read_rgb(out / k / "rgb.exr"), truth[k], border) for k in KINDS]
    numbers = "".join(f"{value:9.2f}" for value in (*values, seconds))
    return f"{name:<9}{shot['name']:<6}{numbers}"


def main() -> None:
    """Render, print the table and where to look."""
    parser = argparse.ArgumentParser(description="Render the sample scenes and measure them.")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the results")
    parser.add_argument("--before-after", type=Path, metavar="PNG", help="write README's picture")
    parser.add_argument("options", nargs="*", help="further options for `defocus render`, after --")
    arguments = parser.parse_args()
    columns = ("scene", "shot", "input", "render", "left", "right", "seconds")
    print(("{:<9}{:<6}" + "{:>9}" * 5).format(*columns))
    rows: dict[str, Array] = {}
    for file in sorted(Path(__file__).parent.glob("*/camera.json")):
        scene, camera = file.parent, json.loads(file.read_text())
        for name, depth in depths(scene, camera).items():
            out = arguments.out / name.replace("*", "_estimated")
            for shot in camera["shots"]:
                start = time.perf_counter()
                words = command(scene, depth, camera, shot, out) + arguments.options
                done = subprocess.run(words, capture_output=True, text=True)
                if done.returncode:
                    failed = f"demo: {name}: this failed: {shlex.join(words)}"
                    sys.exit(f"{done.stderr}{failed}")
                seconds = time.perf_counter() - start
                print(line(name, scene, shot, out, seconds), flush=True)
                rows[name] = contact_row(scene, out)
    write_png(arguments.out / "contact.png", np.concatenate(list(rows.values()), 0))
    if arguments.before_after:
        pairs = [np.hstack(np.hsplit(rows[name], 5)[:2]) for name in BEFORE_AFTER]
        write_png(arguments.before_after, np.vstack(pairs))
    print(
        "PSNR in dB against the thin-lens truth; `input` is the sharp picture.\n"
        "* with depth as networks estimate it: soft at edges, half the size, 8 bits.\n"
        f"Look at {arguments.out}/contact.png: input, render, left, right, CoC of each scene;\n"
        f"single pictures are {arguments.out}/<scene>/{{render,left,right,coc}}/rgb.preview.png."
    )


if __name__ == "__main__":
    main()
