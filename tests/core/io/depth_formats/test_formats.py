"""Each depth format decodes a file that its own rules wrote: no flip, sky far, holes invalid."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import write_exr
from depth_files import colmap, dpt, gdepth, npy, pfm, png
from depth_reading import decoded
from elements import write
from optional_libraries import HEIC_MAGIC, heic, write_hdf5
from refusals import refuses

from defocus_core import read_depth
from defocus_core.io.depth_formats.table import FORMATS

INF, NAN = np.inf, np.nan
# Metres, unlike their own flips and turns.
DEPTH = np.array([[1.0, 2.5, 4.0, 5.5], [8.0, 9.0, 10.5, 12.0], [15.0, 16.0, 18.0, 20.0]])
HOLE = (2, 0)
SKY = (0, 3)
RANGE, PLANAR = {"depth_range": (1000.0, 20_000.0)}, {"geometry": "planar"}
RGB, HEIC_NUMBERS = dict.fromkeys("RGB", DEPTH), np.arange(12).reshape(3, 4) * 20


@dataclass(frozen=True)
class Example:
    """A file of a format."""

    path: Path
    metres: Any  # planar depth; inf is sky, NaN invalid
    said: dict[str, Any] = field(default_factory=dict)  # what a reading must say beside the format
    rtol: float = 1e-6  # half of the relative step of the file's numbers, more or less


def marked(values=DEPTH, *, hole=None, sky=None):
    """Numbers with one that stands for a hole, and one that stands for sky."""
    numbers = np.array(values, np.float64)
    if hole is not None:
        numbers[HOLE] = hole
    if sky is not None:
        numbers[SKY] = sky
    return numbers


def metres(*, hole=False, sky=False):
    return marked(hole=NAN if hole else None, sky=INF if sky else None)


ALPHA = marked(np.ones((3, 4)), sky=0)


def png_of(folder, *, scale, factor=1.0, hole=None, sky=None):
    """A 16-bit PNG of depth · factor · scale."""
    rounded = np.round(DEPTH * factor * scale)
    path = png(folder / "a.png", marked(rounded, hole=hole, sky=sky))
    hole, sky = (None if mark is None else end for mark, end in ((hole, NAN), (sky, INF)))
    return Example(path, marked(rounded / scale, hole=hole, sky=sky))


def exr(folder, name, numbers, **others):
    planes = {name: numbers, **others}
    return write_exr(folder / "a.exr", **{key: np.float32(v) for key, v in planes.items()})


def radial(focal, depth=DEPTH):
    """Distance to the points of a picture of a focal length in px."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width] - np.array([(height - 1) / 2, (width - 1) / 2])[:, None, None]
    return depth * np.sqrt(x**2 + y**2 + focal**2) / focal


def of_hdf5(folder, **arrays):
    path = folder / "a.hdf5"
    return write_hdf5(path, {name: np.asarray(v, np.float32) for name, v in arrays.items()})


def _tartanair2(folder):
    floats = marked(sky=10000.0).astype("<f4")
    blue_first = floats.view(np.uint8).reshape(3, 4, 4)
    path = png(folder / "a.png", blue_first[..., [2, 1, 0, 3]], np.uint8)
    return Example(path, metres(sky=True))


def _sintel(folder):
    (folder / "invalid").mkdir()
    png(folder / "invalid" / "a.png", marked(np.zeros((3, 4)), hole=255), np.uint8)
    return Example(dpt(folder / "a.dpt", marked(sky=1e6)), metres(hole=True, sky=True))


def _nyu_mat(folder):
    frames = np.stack([DEPTH.T + 100, DEPTH.T])  # N, W, H
    raw = np.stack([DEPTH.T, marked(hole=0).T])
    path = of_hdf5(folder, depths=frames, rawDepths=raw)
    return Example(path, metres(hole=True), {"part": 1})


def _diode(folder):
    npy(folder / "a_depth_mask.npy", marked(np.ones((3, 4)), hole=0))
    return Example(npy(folder / "a_depth.npy", DEPTH[:, :, None]), metres(hole=True))


def _float16(folder, factor=1.0, **said):
    halves = marked(hole=0).astype(np.float16)
    path = png(folder / "a.png", halves.view(np.uint16))
    return Example(path, metres(hole=True) * factor, said)


def _ibims1(folder):
    example = png_of(folder, scale=65535 / 50, hole=0, sky=65535)
    (folder / "mask_invalid").mkdir()
    mask = np.full((3, 4), 255)
    mask[1, 1] = 0  # true is valid
    png(folder / "mask_invalid" / "a.png", mask, np.uint8)
    example.metres[1, 1] = NAN
    return example


def _bop(folder):
    (folder / "scene_camera.json").write_text('{"3": {"cam_K": [1], "depth_scale": 0.1}}')
    (folder / "depth").mkdir()
    path = png(folder / "depth" / "000003.png", marked(np.round(DEPTH * 3000), hole=0))
    return Example(path, metres(hole=True) * 0.3)


def _halves(folder):
    numbers = np.round((DEPTH - 1) / 19 * 255)
    path = png(folder / "a.png", np.hstack([numbers * 0 + 7, numbers]), np.uint8)
    return Example(path, 1 + numbers / 255 * 19, {**RANGE, "depth_kind": "depth"})


def _scenenet(folder):
    numbers = np.round(radial(5.0) * 1000)
    numbers[HOLE] = 0
    path = png(folder / "a.png", numbers)
    return Example(path, metres(hole=True), {"focal_px": 5.0}, rtol=1e-3)


def _middlebury(folder):
    text = "cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]\ncam1=[1 0 0; 0 1 0; 0 0 1]\n"
    (folder / "calib.txt").write_text(f"{text}doffs=124.343\nbaseline=193.001\nwidth=2964\n")
    disparity = 3979.911 * 0.193001 / DEPTH - 124.343 / 1
    path = pfm(folder / "disp0.pfm", marked(disparity, hole=INF))
    return Example(path, metres(hole=True), rtol=2e-5)


def _carla(folder):
    packed = np.round(marked(sky=1000.0) / 1000 * (2**24 - 1)).astype(int)
    planes = [packed % 256, packed // 256 % 256, packed // 65536]
    path = png(folder / "a.png", np.stack([*planes, packed * 0 + 255], axis=2), np.uint8)
    return Example(path, metres(sky=True), rtol=1e-4)


def _moge(folder):
    mask = marked(np.full((3, 4), 255), hole=0)
    png(folder / "mask.png", mask, np.uint8)
    numbers = marked(hole=INF)
    numbers[0, 1] = INF
    expected = metres(hole=True)
    expected[0, 1] = NAN
    return Example(write_exr(folder / "depth.exr", Y=np.float32(numbers)), expected)


def _relative(folder):
    numbers = np.round(255 * (1 / DEPTH - 1 / 20) / (1 - 1 / 20))
    path = png(folder / "a.png", numbers, np.uint8)
    return Example(path, 1 / (1 / 20 + numbers / 255 * (1 - 1 / 20)), RANGE)


def _video(folder):
    np.savez(folder / "a.npz", depths=np.stack([DEPTH + 1, DEPTH]).astype(np.float32))
    return Example(folder / "a.npz", metres(), {"depth_kind": "depth", "part": 1})


def _heic(folder):
    (folder / "a.heic").write_bytes(HEIC_MAGIC)
    return Example(folder / "a.heic", 1 / (0.15 + HEIC_NUMBERS / 255 * (3.22 - 0.15)))


def _gdepth(folder):
    near, far = 0.5, 25.0
    image = png(folder / "depth.png", HEIC_NUMBERS, np.uint8).read_bytes()
    properties = {"Format": "RangeInverse", "Near": near, "Far": far, "Mime": "image/png"}
    path = gdepth(folder / "a.jpg", image, **properties, Units="m", MeasureType="OpticalAxis")
    return Example(path, far * near / (far - HEIC_NUMBERS / 255 * (far - near)))


def _npz(folder, said=None, **arrays):
    np.savez(folder / "a.npz", **{k: v.astype(np.float32) for k, v in arrays.items()})
    return Example(folder / "a.npz", metres(sky=True), said or {})


def _exr_of(folder, name, hole=None, sky=None, factor=1.0, **others):
    numbers = marked(DEPTH * factor, hole=hole, sky=sky)
    expected = metres(hole=hole is not None, sky=sky is not None)
    return Example(exr(folder, name, numbers, **others), expected)


def _radial_exr(folder, name, **said):
    numbers = marked(radial(5.0), hole=0)
    said["focal_px"] = 5.0
    return Example(exr(folder, name, numbers), metres(hole=True), said, 1e-5)


def _npy_of(folder, hole=None, sky=None):
    path = npy(folder / "a.npy", marked(hole=hole, sky=sky))
    return Example(path, metres(hole=hole is not None, sky=sky is not None))


def _cityscapes(folder):
    numbers = np.round(256 * 226.252 * 0.209313 / DEPTH + 1)
    said = {"focal_px": 226.252, "baseline": 209.313}
    return Example(png(folder / "a.png", marked(numbers, hole=0)), metres(hole=True), said, 1e-3)


def _alicevision(folder):
    z = marked(radial(4.0), hole=-1).astype("f4")
    path = write(folder / "a.exr", {"Z": z}, **{"AliceVision:iCamArr": np.eye(3)})
    return Example(path, metres(hole=True), {"focal_px": 4.0})


def _unreal(folder):
    numbers = marked(DEPTH * 100, sky=65504 * 3e3)
    depth = {f"FinalImageMovieRenderQueue_WorldDepth.{c}": numbers for c in "RGB"}
    depth["FinalImageMovieRenderQueue_WorldDepth.A"] = numbers * 0 + 1
    color = {"R": DEPTH, "G": DEPTH * 2, "B": DEPTH, "A": DEPTH * 0 + 1}
    planes = {name: np.float32(values) for name, values in (depth | color).items()}
    return Example(write(folder / "a.exr", planes), metres(sky=True))


EXAMPLES: dict[str, Callable[[Path], Example]] = {
    "metres": partial(_exr_of, name="Z", sky=INF, hole=NAN),
    "disparity": lambda f: Example(
        npy(f / "a.npy", marked(500 * 0.1 / DEPTH - 2, hole=NAN)),
        metres(hole=True),
        {"focal_px": 500.0, "baseline": 100.0, "doffs": 2.0},
    ),
    "coc": lambda f: Example(exr(f, "coc", DEPTH - 9), DEPTH - 9),
    "blender": lambda f: _exr_of(
        f, "ViewLayer.Depth.Z", sky=1e10, **{"ViewLayer.Mist.Z": DEPTH * 2, "ViewLayer.A": DEPTH}
    ),
    "blenderproc": lambda f: Example(
        of_hdf5(f, colors=DEPTH * 2, depth=marked(sky=1e10), distance=DEPTH * 3), metres(sky=True)
    ),
    "mujoco-warp": lambda f: Example(npy(f / "a.npy", marked()), metres(), PLANAR),
    "cityscapes": _cityscapes,
    "vision-blender": lambda f: _npz(f, depth_map=marked(sky=1e10), normal_map=np.ones((3, 4, 3))),
    "kubric": lambda f: _npz(f, PLANAR, depth=marked(sky=INF)),
    "alicevision": _alicevision,
    "mitsuba": lambda f: _radial_exr(f, "depth"),
    "unreal-mrq": _unreal,
    "unity-perception": partial(_radial_exr, name="R", geometry="radial"),
    "carla": _carla,
    "nuke-scanline": lambda f: Example(
        exr(f, "depth.Z", marked(1 / DEPTH, sky=0), **RGB), metres(sky=True)
    ),
    "arnold": partial(_exr_of, name="Z", hole=0, sky=3.0, **RGB, A=ALPHA),
    "houdini": partial(_exr_of, name="Pz", hole=0, sky=3.0, factor=-1, A=ALPHA),
    "vray-zdepth": lambda f: Example(
        exr(f, "Z", (20 - DEPTH) / 19), metres(), {"depth_range": (20_000.0, 1000.0)}, 1e-5
    ),
    "colmap": lambda f: Example(colmap(f / "a.bin", marked(hole=0)), metres(hole=True)),
    "hypersim": lambda f: Example(
        of_hdf5(f, dataset=marked(radial(886.81 * 4 / 1024), hole=NAN)), metres(hole=True)
    ),
    "tartanair": partial(_npy_of, sky=10000.0),
    "tartanair2": _tartanair2,
    "sintel": _sintel,
    "isaac-plane": partial(_npy_of, sky=0.0),
    "isaac-camera": lambda f: Example(
        npy(f / "distance_to_camera_0000.npy", marked(radial(5.0), sky=INF)),
        metres(sky=True),
        {"focal_px": 5.0},
    ),
    "bop": _bop,
    "7scenes": partial(png_of, scale=1000, hole=65535),
    "taskonomy": partial(png_of, scale=512, hole=65535),
    "kitti": partial(png_of, scale=256, hole=0),
    "vkitti2": partial(png_of, scale=100, sky=65535),
    "nyu-mat": _nyu_mat,
    "matterport": partial(png_of, scale=4000, factor=0.8, hole=0),
    "diode": _diode,
    "pointodyssey": partial(png_of, scale=65.535, hole=0, sky=65535),
    "dynamicreplica": _float16,
    "co3d": partial(_float16, factor=0.5, depth_scale=0.5),
    "mvs-synth": lambda f: _exr_of(f, "Z", sky=INF),
    "bedlam": lambda f: _exr_of(f, "Depth", sky=30000.0, factor=100, R=DEPTH, G=DEPTH, B=DEPTH * 2),
    "3dkenburns": lambda f: _exr_of(f, "Z", sky=30000.0, factor=1000),
    "png-mm": partial(png_of, scale=1000, hole=0),
    "tum": partial(png_of, scale=5000, factor=0.5, hole=0),
    "ibims1": _ibims1,
    "scenenet-rgbd": _scenenet,
    "middlebury": _middlebury,
    "middlebury2003": lambda f: Example(
        png(f / "disp2.png", marked(np.round(200 / DEPTH), hole=0), np.uint8),
        marked(900 * 0.1 / (np.round(200 / DEPTH) / 4), hole=NAN),
        {"focal_px": 900.0, "baseline": 100.0},
    ),
    "megadepth": lambda f: Example(
        of_hdf5(f, depth=marked(hole=0)), metres(hole=True) * 3, {"depth_scale": 3.0}
    ),
    "sceneflow": lambda f: Example(pfm(f / "a.pfm", marked(1050 / DEPTH, sky=0)), metres(sky=True)),
    "moge": _moge,
    "depth-pro": lambda f: _npz(f, depth=marked(sky=1e10)),
    "depth-anything": _relative,
    "video-depth-anything": _video,
    "depth-anything-3": lambda f: _npz(f, PLANAR, depth=marked(sky=INF)[None]),
    "marigold": lambda f: Example(npy(f / "a.npy", (DEPTH - 1) / 19), metres(), RANGE, 1e-5),
    "apple-heic": _heic,
    "android-gdepth": _gdepth,
    "side-by-side": _halves,
}


@pytest.fixture(autouse=True)
def libraries():
    with heic(HEIC_NUMBERS.astype(np.uint8), d_min=0.15, d_max=3.22):
        yield


def test_every_format_has_an_example():
    assert EXAMPLES.keys() == FORMATS.keys()


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_of_the_format_becomes_planar_metres(name, tmp_path):
    example = EXAMPLES[name](tmp_path)
    depth = decoded(example.path, depth_format=name, **example.said)
    valid = ~np.isnan(example.metres)
    np.testing.assert_array_equal(depth.invalid, ~valid)
    np.testing.assert_allclose(depth.metres[:][valid], example.metres[valid], rtol=example.rtol)
    assert depth.metres.dtype == np.float32


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("marigold", ["needs ‹depth-range›"]),
        ("video-depth-anything", ["needs ‹depth-kind›"]),
        ("co3d", ["needs ‹depth-scale›", "scale_adjustment"]),
        ("kubric", ["add ‹planar› or ‹radial›"]),
        ("mitsuba", ["‹fov› 60deg or ‹focal-px› PX"]),
        ("middlebury", ["needs ‹focal-px› and ‹baseline›: there is no calib.txt beside"]),
        ("disparity", ["‹focal-px› PX and ‹baseline› 65mm, or ‹depth-range› NEAR FAR, or"]),
    ],
)
def test_what_no_format_may_guess_is_asked_for(name, words, tmp_path):
    example = EXAMPLES[name](tmp_path)
    for sidecar in (p for p in tmp_path.rglob("*") if p.suffix in (".txt", ".cfg", ".json")):
        sidecar.unlink()
    with refuses("missing-option", *words, field="depth-format", value=name):
        read_depth(example.path, format=name, part=example.said.get("part"))
