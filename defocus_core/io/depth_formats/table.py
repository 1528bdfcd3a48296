"""The table of depth formats by name, the units of depth, and the default of each type of file.

No format is guessed from the range of values. A file without a named format is read by the default
of its type: floats are metres, 16-bit integers of PNG and TIFF are millimetres; integers of EXR and
NPY have no default, so that their unit must be set (``depth_unit``).

A new format is a row, and a line of ``help/depth.md``, which a test compares. The rows are ordered:
renderers, data sets of depth, stereo data sets, networks and phones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

SKY = 1e10  # Blender's far clip: this and greater numbers are sky in every format of depth
FLOATS = ("EXR", "PFM", "NPY", "NPZ", "float TIFF")
# Channels of Unreal's depth: R, G and B are equal, A is 1; a fault of its writer corrupts the text
# after the dot.
UNREAL_DEPTH = tuple(
    f"FinalImage{writer}WorldDepth{end}"
    for writer in ("MovieRenderQueue_", "PW")
    for end in (".R", "*")
)
ANY = (*FLOATS, "16-bit PNG", "8-bit PNG", "8-bit RGB", "integer EXR", "integer NPY", "HDF5")


@dataclass(frozen=True)
class Mask:
    """An image or array beside the depth file that marks pixels without depth."""

    # Where it may lie, relative to the depth file's folder; ``{stem}`` is the stem of the depth
    # file, ``{folder}`` the name of its folder
    places: tuple[str, ...]
    zeros: bool = True  # whether the mask marks pixels by 0, or by any other number


@dataclass(frozen=True)
class DepthFormat:
    """A depth convention: a row of the table, which sidecar and user complete for each file."""

    name: str  # a value of ``depth_format``
    title: str  # the data set, renderer or network that writes it
    files: tuple[str, ...]  # its types of file, each a value of `DepthNumbers.type`
    # A key of `rules.RULES`; empty where ``depth_kind`` must name depth or disparity
    rule: str = "scale"
    takes: tuple[str, ...] = ()  # options that the format uses, besides those of the rule
    needs: tuple[str, ...] = ()  # options without which a file cannot be decoded
    scale: float = 1.0  # factor on the numbers, to metres of depth or px of disparity
    shift: float = 0.0  # added after scaling
    # Depth in m or disparity in 1/m of 0 and of the greatest number, where the file gives them
    ends: tuple[float, float] | None = None
    bits: str = ""  # ``float32`` or ``float16`` where the bits of a pixel are those of a float
    weights: tuple[float, ...] = ()  # of R, G and B in the number, where it is spread over them
    # Names or patterns of EXR channels, or of arrays in a file, in order of preference; empty for
    # the usual names
    channels: tuple[str, ...] = ()
    holes: str = ""  # name of the array in the same file whose zeros are invalid
    radial_channels: tuple[str, ...] = ()  # those of `channels` that hold distance to the point
    axes: str = "HW"  # order of axes in the file, N for frames
    geometry: str = "planar"  # planar, radial, or ask, where the user must choose
    # Numbers that mean no depth (inf then is not sky), besides NaN, 0 and negative depth
    invalid: tuple[float, ...] = ()
    # This number and greater ones are sky; in a completed row where numbers fall with distance,
    # this number and smaller ones
    sky: float = SKY
    sky_numbers: tuple[float, ...] = ()  # further numbers that are sky
    # Focal length in px if all its pictures have one; in a completed row, that of the picture
    focal_px: float | None = None
    focal_width: int | None = None  # width in px of pictures with `focal_px`; None for any width
    baseline: float | None = None  # metres between its two cameras, where it is fixed
    sidecar: str = ""  # name of the kind of sidecar, as in `sidecars`
    words: str = ""  # of a completed row: how numbers become depth, for people
    mask: Mask | None = None
    alpha: bool = False  # whether pixels with an alpha of 0 in the EXR are empty
    is_right_half: bool = False  # whether depth is the right half of a picture, colour the left
    note: str = ""  # further advice for users
    aliases: tuple[str, ...] = ()


def _row(names: str, title: str, files: tuple[str, ...], **fields: Any) -> DepthFormat:
    name, *aliases = names.split()
    return DepthFormat(name, title, files, aliases=tuple(aliases), **fields)


# Fields that rows have in common: disparity in px of two cameras; 16 bits with 0 as a hole; EXR in
# units of a scene.
_stereo = partial(_row, rule="inverse")
_png16 = partial(_row, files=("16-bit PNG",), invalid=(0,))
_exr = partial(_row, files=("EXR",), takes=("depth-unit",))
_INF = (math.inf,)
_isaac = partial(_row, files=("NPY",), sky_numbers=(0.0,))
_tartan = partial(_row, sky=1000.0, focal_px=320.0, focal_width=640)
_PICTURES = ("16-bit PNG", "8-bit PNG")
_BEYOND_20000 = 20000.002  # the next float32
_SCENE = "units of the scene, as metres unless ‹depth-unit› says otherwise"
_ALPHA = f"{_SCENE}; where alpha is 0 is sky"


ROWS: tuple[DepthFormat, ...] = (
    # Renderers
    _row(
        "metres blendedmvs habitat depth-anything-v2-metric",
        "any file of depth, in the unit of ‹depth-unit›: BlendedMVS, Habitat's pinhole camera, "
        "Depth Anything V2 metric (*_raw_depth_meter.npy), …",
        ANY,
        takes=("depth-unit", "depth-range"),
    ),
    _row(
        "disparity inverse",
        "any file of disparity",
        ANY,
        rule="inverse",
        takes=("depth-range",),
        note="0 is infinitely far; a scale, a range, or focal length and baseline must be said",
    ),
    _row(
        "coc",
        "signed radius of the circle of confusion in px, as 'render ‹outputs› coc' writes it",
        FLOATS,
        rule="radius",
        channels=("coc",),
        note="used as it is: of the lens, only ‹blades› and ‹blade-rotation› have an effect",
    ),
    _exr(
        "blender",
        "Blender, pass Z",
        channels=("*.Depth.Z", "Depth.Z", "Z", "*.Depth.V", "Depth.V", "V"),
        note=f"{_SCENE}; the pass Mist is not depth",
    ),
    _row(
        "blenderproc",
        "BlenderProc",
        ("HDF5",),
        channels=("depth", "distance"),
        radial_channels=("distance",),
    ),
    _row("vision-blender", "VisionBlender", ("NPZ",), channels=("depth_map", "depth*", "*")),
    _row("kubric", "Kubric", ("float TIFF", "NPZ", "EXR"), geometry="ask"),
    _exr(
        "mitsuba",
        "Mitsuba, AOV depth",
        channels=("depth", "*depth*", "*.T", "dd.y"),
        geometry="radial",
        note="some versions are off by the near clip",
    ),
    _row(
        "unreal-mrq unreal",
        "Unreal, Movie Render Queue",
        ("EXR",),
        scale=1 / 100,
        channels=(*UNREAL_DEPTH, "ImageDepth.R", "ImageDepth*", "*WorldDepth*", "R"),
        sky=1e6,
        sky_numbers=(65504,),
    ),
    _row(
        "unity-perception",
        "Unity Perception",
        ("EXR",),
        channels=("R", "*"),
        geometry="ask",
        note="its Depth strategy is ‹planar›, its Range strategy ‹radial›",
    ),
    _row(
        "carla",
        "CARLA, depth camera",
        ("8-bit RGB", "8-bit RGBA"),
        scale=1000 / (2**24 - 1),
        weights=(1.0, 256.0, 65536.0),
        sky=2.0**24 - 1,
    ),
    # docs.omniverse.nvidia.com, Replicator, "Annotators Information": float32 in metres, "0 in the
    # 2d array represents infinity"
    _isaac("isaac-plane", "Isaac Sim, distance_to_image_plane"),
    _isaac("isaac-camera", "Isaac Sim, distance_to_camera", geometry="radial"),
    _row(
        "mujoco-warp newton",
        "MuJoCo Warp, Newton",
        FLOATS,
        geometry="ask",
        note="radial in versions before March 2026, planar since",
    ),
    _exr("nuke-scanline", "Nuke, ScanlineRender, 1/z", rule="per-metre", channels=("depth.Z", "Z")),
    _exr(
        "arnold redshift karma",
        "Arnold, Redshift, Karma",
        channels=("Z", "depth.Z", "*.Z"),
        alpha=True,
        note=_ALPHA,
    ),
    _exr(
        "houdini",
        "Houdini, Pz: negative in front of the camera",
        scale=-1.0,
        channels=("Pz", "*.Pz", "*Pz"),
        alpha=True,
        note=_ALPHA,
    ),
    _row(
        "vray-zdepth",
        "V-Ray, ZDepth",
        ("EXR", "16-bit PNG", "8-bit PNG", "float TIFF"),
        channels=("VRayZDepth*", "ZDepth*", "zDepth*", "Z", "R", "*"),
        needs=("depth-range",),
        note="‹depth-range› is the distance of black, then of white",
    ),
    _row("colmap", "COLMAP, depth_maps/*.bin", ("COLMAP",), takes=("depth-unit",), note=_SCENE),
    # Data sets of depth
    _row(
        "hypersim",
        "Hypersim, depth_meters.hdf5",
        ("HDF5",),
        channels=("dataset",),
        geometry="radial",
        focal_px=886.81,
        focal_width=1024,
        note="NaN is sky or a window; scenes with a tilted or shifted lens need ‹focal-px›",
    ),
    _tartan("tartanair", "TartanAir, depth_left.npy", ("NPY",)),
    _tartan(
        "tartanair2", "TartanAir V2, a float32 in R, G, B and A", ("8-bit RGBA",), bits="float32"
    ),
    _row(
        "sintel",
        "MPI Sintel",
        ("DPT",),
        sky=1e4,
        mask=Mask(
            (
                *("{stem}_invalid.png", "invalid/{stem}.png", "../invalid/{stem}.png"),
                "../../invalid/{folder}/{stem}.png",
            ),
            zeros=False,
        ),
    ),
    _png16(
        "png-mm scannet scannetpp nyu nyu-png hypersim-marigold arkitscenes arkit wildrgbd hoi4d "
        "uasol dp5k",
        "millimetres: ScanNet, ScanNet++, NYU Depth V2 as PNG, Hypersim as Marigold prepares it, "
        "ARKitScenes, WildRGBD, HOI4D, UASOL, …",
        scale=1 / 1000,
        note="ARKitScenes: turn both pictures so that the sky is above",
    ),
    # github.com/thodan/bop_toolkit, docs/bop_datasets_format.md: × depth_scale is mm, 0 is a hole
    _png16(
        "bop ycbv tless",
        "BOP (LM-O, T-LESS, YCB-V, …), depth/*.png",
        scale=1 / 1000,
        sidecar="scene_camera.json",
    ),
    # microsoft.com, "RGB-D Dataset 7-Scenes": "in millimeters … invalid depth is set to 65535"
    _png16("7scenes", "7-Scenes, *.depth.png", scale=1 / 1000, invalid=(0, 65535)),
    # github.com/EPFL-VILAB/omnidata, omnidata_tools: dataset/README.md, "increments of 1/512m";
    # torch/dataloader/task_configs.py, whose mask_val of depth_zbuffer is the greatest number
    _png16(
        "taskonomy omnidata",
        "Taskonomy, Omnidata, depth_zbuffer",
        scale=1 / 512,
        invalid=(0, 65535),
    ),
    _png16("kitti", "KITTI depth, sparse", scale=1 / 256),
    _png16("vkitti2 vkitti", "Virtual KITTI 2", scale=1 / 100, invalid=(), sky=65500),
    _row(
        "nyu-mat",
        "NYU Depth V2, nyu_depth_v2_labeled.mat",
        ("HDF5",),
        channels=("depths", "rawDepths"),
        axes="NWH",
        holes="rawDepths",
        note="‹part› N chooses the frame; pixels without raw depth are invalid",
    ),
    _png16("matterport", "Matterport3D, undistorted_depth_images", scale=1 / 4000),
    _row("diode", "DIODE", ("NPY",), mask=Mask(("{stem}_mask.npy",))),
    _png16("pointodyssey", "PointOdyssey", scale=1000 / 65535, sky=65535),
    _png16("dynamicreplica", "Dynamic Replica, float16 in 16 bits", bits="float16"),
    _png16(
        "co3d",
        "CO3D, float16 in 16 bits",
        bits="float16",
        needs=("depth-scale",),
        note="‹depth-scale› is scale_adjustment of frame_annotations.jgz",
    ),
    _exr("mvs-synth", "MVS-Synth", note="units of the game"),
    _row(
        "bedlam",
        "BEDLAM and BEDLAM2",
        ("EXR",),
        scale=1 / 100,
        channels=("Depth", *UNREAL_DEPTH, "*.Depth"),
        sky=_BEYOND_20000,
    ),
    _row("3dkenburns", "3D Ken Burns", ("EXR",), scale=1 / 1000, sky=_BEYOND_20000),
    _row(
        "megadepth",
        "MegaDepth",
        ("HDF5",),
        channels=("depth",),
        needs=("depth-scale",),
        note="without a metric scale: ‹depth-scale› says metres of 1",
    ),
    _png16("tum bonn smartportraits", "TUM RGB-D, Bonn, SmartPortraits", scale=1 / 5000),
    _png16(
        "ibims1",
        "iBims-1",
        scale=50 / 65535,
        sky=65535,
        mask=Mask(
            ("{stem}_mask_invalid.png", "mask_invalid/{stem}.png", "../mask_invalid/{stem}.png")
        ),
        note="mask_invalid is true where the depth is valid",
    ),
    _png16("scenenet-rgbd", "SceneNet RGB-D", scale=1 / 1000, geometry="radial"),
    # Stereo data sets
    _stereo("middlebury", "Middlebury stereo", ("PFM",), invalid=_INF, sidecar="calib.txt"),
    _stereo(
        "middlebury2003",
        "Middlebury 2003 as PNG, a quarter of the size",
        ("8-bit PNG",),
        scale=1 / 4,
        invalid=(0,),
        note="pictures of half the size need ‹depth-scale› 2",
    ),
    _stereo(
        "sceneflow flyingthings3d monkaa driving",
        "FlyingThings3D, Monkaa, Driving",
        ("PFM",),
        focal_px=1050.0,
        baseline=1.0,
        note="pictures of 15 mm need ‹focal-px› 450",
    ),
    _stereo(
        "cityscapes",
        "Cityscapes, disparity: (v - 1) / 256 px",
        ("16-bit PNG",),
        scale=1 / 256,
        invalid=(0,),
        shift=-1 / 256,
    ),
    # Networks and telephones
    _exr(
        "moge",
        "MoGe, depth.exr",
        invalid=_INF,
        mask=Mask(("mask.png", "{stem}_mask.png")),
        note="version 1 has no scale: give ‹depth-scale›",
    ),
    _row("depth-pro", "Depth Pro", ("NPZ",), channels=("depth",)),
    _row(
        "depth-anything midas",
        "Depth Anything relative, MiDaS: disparity without scale and shift",
        (*_PICTURES, *FLOATS),
        rule="inverse",
        needs=("depth-range",),
    ),
    _row(
        "video-depth-anything",
        "Video Depth Anything",
        ("NPZ", "EXR"),
        rule="",
        takes=("depth-range",),
        channels=("depths", "depth", "Z", "*"),
        axes="NHW",
        note="the metric model writes depth, the others disparity; ‹part› N chooses the frame",
    ),
    _row(
        "depth-anything-3",
        "Depth Anything 3",
        FLOATS,
        channels=("depth", "*"),
        axes="NHW",
        geometry="ask",
        takes=("depth-unit",),
        note="whether z or the length of the ray is open; units of the network",
    ),
    _row("marigold", "Marigold, affine depth", ("NPY", "16-bit PNG"), needs=("depth-range",)),
    _row(
        "apple-heic",
        "iPhone portrait, HEIC or JPEG",
        ("HEIC", "Apple JPEG"),
        rule="per-metre",
        sidecar="heic",
    ),
    _exr(
        "alicevision",
        "AliceVision, Meshroom, depthMap.exr",
        invalid=(-1,),
        geometry="radial",
        note="known by its header",
    ),
    _row("android-gdepth", "Android, JPEG with GDepth", ("GDepth",), sidecar="gdepth"),
    # docs.lookingglassfactory.com, "RGBD Photos": the depth in grey beside the colour
    _row(
        "side-by-side rgbd",
        "Looking Glass RGBD, colour in the left half and depth in the right",
        _PICTURES,
        rule="",
        needs=("depth-range",),
        is_right_half=True,
        note="name the file twice, as colour and as depth; or take it as relative with ‹blur›",
    ),
)
OF_PHOTOGRAPHS = ("apple-heic", "android-gdepth")
FORMATS = {row.name: row for row in ROWS}
NAMES = {name: row for row in ROWS for name in (row.name, *row.aliases)}
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ft": 0.3048}  # metres of 1 in the file
UNIT_WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "ft": "feet"}
