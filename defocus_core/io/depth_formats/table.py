"""The table of depth formats by name, the units of depth, and the custom of each type of file.

Nothing is read off the range of the values. A file without a named format follows the custom of its
type: floats are metres, and 16-bit integers of PNG and TIFF millimetres; integers of EXR and NPY
have no custom, so that their unit must be set (``depth_unit``).

A new format is a row, and a line of ``help/depth.md``, which the test of that topic prints; its
fields are in `rules`. The rows are of stereo data sets, networks, renderers, data sets of depth.
"""

from __future__ import annotations

from defocus_core.io.depth_formats.depth_numbers import DepthNumbers
from defocus_core.io.depth_formats.rules import ANY, FLOATS, UNREAL_DEPTH, DepthFormat, Mask

STEREO_DATASETS = (
    DepthFormat(
        name="middlebury",
        title="Middlebury stereo",
        files=("PFM",),
        rule="inverse",
        invalid_infinity=True,
        sidecar="calib.txt",
    ),
    DepthFormat(
        name="sceneflow",
        title="FlyingThings3D, Monkaa, Driving",
        files=("PFM",),
        rule="inverse",
        focal_px=1050.0,
        baseline=1.0,
        note="pictures of 15 mm need ‹focal-px› 450",
        aliases=("flyingthings3d", "monkaa", "driving"),
    ),
    DepthFormat(
        name="cityscapes",
        title="Cityscapes, disparity: (v - 1) / 256 px",
        files=("16-bit PNG",),
        rule="inverse",
        scale=1 / 256,
        invalid=(0,),
        sidecar="camera.json",
    ),
    DepthFormat(
        name="irs",
        title="IRS",
        files=("EXR",),
        rule="inverse",
        channels=("G", "*"),
        invalid=(0,),
        focal_px=480.0,
        baseline=0.1,
    ),
    DepthFormat(
        name="unrealstereo4k",
        title="UnrealStereo4K",
        files=("NPY",),
        rule="inverse",
        invalid=(0,),
        invalid_infinity=True,
        sidecar="Extrinsics",
    ),
    DepthFormat(
        name="spring",
        title="Spring, .dsp5 at twice the size",
        files=("HDF5",),
        rule="inverse",
        channels=("disparity",),
        stride=2,
        invalid=(0,),
        baseline=0.065,
        sidecar="intrinsics.txt",
    ),
    DepthFormat(
        name="hci-lightfield",
        title="HCI 4D light fields, disparity about the focus plane",
        files=("PFM",),
        rule="inverse",
        sidecar="parameters.cfg",
    ),
    DepthFormat(
        name="ffs-stereo4d",
        title="Stereo4D of Fast Foundation Stereo, (255² R + 255 G + B) / 1000 px",
        files=("8-bit RGB", "8-bit RGBA"),
        rule="inverse",
        scale=1 / 1000,
        weights=(255.0**2, 255.0, 1.0),
    ),
)


_PICTURES = ("16-bit PNG", "8-bit PNG")

NETWORKS = (
    DepthFormat(
        name="moge-png",
        title="MoGe, depth in the logarithm",
        files=("16-bit PNG",),
        rule="log",
        invalid=(0,),
        sky=65535,
        sidecar="text-chunks",
    ),
    DepthFormat(
        name="moge",
        title="MoGe, depth.exr",
        files=("EXR",),
        invalid_infinity=True,
        mask=Mask(("mask.png", "{stem}_mask.png"), "invalid", "zero"),
        unitless=True,
        note="version 1 has no scale: give ‹depth-scale›",
    ),
    DepthFormat(
        name="depth-pro",
        title="Depth Pro",
        files=("NPZ",),
        channels=("depth",),
    ),
    DepthFormat(
        name="depth-anything-v2-metric",
        title="Depth Anything V2 metric, *_raw_depth_meter.npy",
        files=("NPY",),
    ),
    DepthFormat(
        name="depth-anything",
        title="Depth Anything relative, MiDaS: disparity without scale and shift",
        files=(*_PICTURES, *FLOATS),
        rule="inverse",
        needs=("depth-range",),
        aliases=("midas",),
    ),
    DepthFormat(
        name="video-depth-anything",
        title="Video Depth Anything",
        files=("NPZ",),
        rule="",
        channels=("depths", "depth", "*"),
        axes="NHW",
        note="the metric model writes depth, the others disparity; ‹part› N chooses the frame",
    ),
    DepthFormat(
        name="depth-anything-3",
        title="Depth Anything 3",
        files=FLOATS,
        channels=("depth", "*"),
        axes="NHW",
        geometry="ask",
        unitless=True,
        note="whether z or the length of the ray is open; units of the network",
    ),
    DepthFormat(
        name="marigold",
        title="Marigold, affine depth",
        files=("NPY", "16-bit PNG"),
        needs=("depth-range",),
    ),
    DepthFormat(
        name="apple-heic",
        title="iPhone portrait, HEIC",
        files=("HEIC",),
        rule="inverse",
        per_metre=True,
        sidecar="heic",
    ),
    DepthFormat(
        name="android-gdepth",
        title="Android, JPEG with GDepth",
        files=("GDepth",),
        sidecar="gdepth",
    ),
)


_SCENE = "units of the scene, as metres unless ‹depth-unit› says otherwise"
_ALPHA = f"{_SCENE}; where alpha is 0 is sky"

RENDERERS = (
    DepthFormat(
        name="metres",
        title="any file of depth, in the unit of ‹depth-unit›",
        files=ANY,
        unitless=True,
    ),
    DepthFormat(
        name="disparity",
        title="any file of disparity",
        files=ANY,
        rule="inverse",
        note="0 is infinitely far; a scale, a range, or focal length and baseline must be said",
        aliases=("inverse",),
    ),
    DepthFormat(
        name="coc",
        title="signed radius of the circle of confusion in px, as 'render ‹outputs› coc' writes it",
        files=FLOATS,
        rule="radius",
        channels=("coc",),
        note="used as it is: of the lens, only ‹blades› and ‹blade-rotation› have an effect",
    ),
    DepthFormat(
        name="blender",
        title="Blender, pass Z",
        files=("EXR",),
        channels=("*.Depth.Z", "Depth.Z", "Z", "*.Depth.V", "Depth.V", "V"),
        unitless=True,
        note=f"{_SCENE}; the pass Mist is no depth",
    ),
    DepthFormat(
        name="blenderproc",
        title="BlenderProc",
        files=("HDF5",),
        channels=("depth", "distance"),
        radial_channels=("distance",),
    ),
    DepthFormat(
        name="vision-blender",
        title="VisionBlender",
        files=("NPZ",),
        channels=("depth_map", "depth*", "*"),
    ),
    DepthFormat(
        name="kubric",
        title="Kubric",
        files=("float TIFF", "NPZ", "EXR"),
        geometry="ask",
    ),
    DepthFormat(
        name="mitsuba",
        title="Mitsuba, AOV depth",
        files=("EXR",),
        channels=("depth", "*depth*", "*.T", "dd.y"),
        geometry="radial",
        invalid=(0,),
        unitless=True,
        note="some versions are off by the near clip",
    ),
    DepthFormat(
        name="unreal-mrq",
        title="Unreal, Movie Render Queue",
        files=("EXR",),
        scale=1 / 100,
        channels=(*UNREAL_DEPTH, "ImageDepth.R", "ImageDepth*", "*WorldDepth*", "R"),
        sky=1e6,
        sky_numbers=(65504,),
        aliases=("unreal",),
    ),
    DepthFormat(
        name="unity-perception",
        title="Unity Perception",
        files=("EXR",),
        channels=("R", "*"),
        geometry="ask",
        note="its Depth strategy is ‹planar›, its Range strategy ‹radial›",
    ),
    DepthFormat(
        name="carla",
        title="CARLA, depth camera",
        files=("8-bit RGB", "8-bit RGBA"),
        scale=1000 / (2**24 - 1),
        weights=(1.0, 256.0, 65536.0),
        sky=2.0**24 - 1,
    ),
    DepthFormat(
        name="habitat",
        title="Habitat, pinhole camera",
        files=FLOATS,
        invalid=(0,),
        note="an equirectangular camera writes the distance to the point: ‹radial›",
    ),
    DepthFormat(
        name="mujoco-warp",
        title="MuJoCo Warp, Newton",
        files=FLOATS,
        geometry="ask",
        note="radial in versions before March 2026, planar since",
        aliases=("newton",),
    ),
    DepthFormat(
        name="nuke-scanline",
        title="Nuke, ScanlineRender, 1/z",
        files=("EXR",),
        rule="inverse",
        channels=("depth.Z", "Z"),
        per_metre=True,
        unitless=True,
    ),
    DepthFormat(
        name="arnold",
        title="Arnold, Redshift, Karma",
        files=("EXR",),
        channels=("Z", "depth.Z", "*.Z"),
        alpha=True,
        invalid=(0,),
        unitless=True,
        note=_ALPHA,
        aliases=("redshift", "karma"),
    ),
    DepthFormat(
        name="houdini",
        title="Houdini, Pz: negative in front of the camera",
        files=("EXR",),
        scale=-1.0,
        channels=("Pz", "*.Pz", "*Pz"),
        alpha=True,
        invalid=(0,),
        unitless=True,
        note=_ALPHA,
    ),
    DepthFormat(
        name="vray-zdepth",
        title="V-Ray, ZDepth",
        files=("EXR", "16-bit PNG", "8-bit PNG", "float TIFF"),
        channels=("VRayZDepth*", "ZDepth*", "zDepth*", "Z", "R", "*"),
        needs=("depth-range",),
        note="‹depth-range› is the distance of black, then of white",
    ),
    DepthFormat(
        name="colmap",
        title="COLMAP, depth_maps/*.bin",
        files=("COLMAP",),
        invalid=(0,),
        unitless=True,
        note=_SCENE,
    ),
)


_PNG16 = ("16-bit PNG",)
_BEYOND_20000 = 20000.002  # the next float32

DEPTH_DATASETS = (
    DepthFormat(
        name="hypersim",
        title="Hypersim, depth_meters.hdf5",
        files=("HDF5",),
        channels=("dataset",),
        geometry="radial",
        focal_px=886.81,
        focal_width=1024,
        note="NaN is sky or a window; scenes with a tilted or shifted lens need ‹focal-px›",
    ),
    DepthFormat(
        name="hypersim-marigold",
        title="Hypersim as Marigold prepares it",
        files=_PNG16,
        scale=1 / 1000,
        invalid=(0,),
    ),
    DepthFormat(
        name="tartanair",
        title="TartanAir, depth_left.npy",
        files=("NPY",),
        sky=1000.0,
        focal_px=320.0,
        focal_width=640,
    ),
    DepthFormat(
        name="tartanair2",
        title="TartanAir V2, a float32 in R, G, B and A",
        files=("8-bit RGBA",),
        bits="float32",
        sky=1000.0,
        focal_px=320.0,
        focal_width=640,
    ),
    DepthFormat(
        name="sintel",
        title="MPI Sintel",
        files=("DPT",),
        sky=1e4,
        mask=Mask(
            (
                *("{stem}_invalid.png", "invalid/{stem}.png", "../invalid/{stem}.png"),
                "../../invalid/{folder}/{stem}.png",
            ),
            "invalid",
            "nonzero",
        ),
    ),
    DepthFormat(
        name="kitti",
        title="KITTI depth, sparse",
        files=_PNG16,
        scale=1 / 256,
        invalid=(0,),
    ),
    DepthFormat(
        name="vkitti2",
        title="Virtual KITTI 2",
        files=_PNG16,
        scale=1 / 100,
        sky=65500,
        aliases=("vkitti",),
    ),
    DepthFormat(
        name="nyu-png",
        title="NYU Depth V2 as PNG",
        files=_PNG16,
        scale=1 / 1000,
        invalid=(0,),
        note="the crop of Eigen is a mask and no crop",
        aliases=("nyu",),
    ),
    DepthFormat(
        name="nyu-mat",
        title="NYU Depth V2, nyu_depth_v2_labeled.mat",
        files=("HDF5",),
        channels=("depths", "rawDepths"),
        axes="NWH",
        holes="rawDepths",
        note="‹part› N chooses the frame; pixels without raw depth are invalid",
    ),
    DepthFormat(
        name="scannet",
        title="ScanNet",
        files=_PNG16,
        scale=1 / 1000,
        invalid=(0,),
        note="resize the colour to the size of the depth",
    ),
    DepthFormat(
        name="scannetpp",
        title="ScanNet++, rendered",
        files=_PNG16,
        scale=1 / 1000,
        invalid=(0,),
    ),
    DepthFormat(
        name="matterport",
        title="Matterport3D, undistorted_depth_images",
        files=_PNG16,
        scale=1 / 4000,
        invalid=(0,),
    ),
    DepthFormat(
        name="diode",
        title="DIODE",
        files=("NPY",),
        invalid=(0,),
        mask=Mask(("{stem}_mask.npy",), "invalid", "zero"),
    ),
    DepthFormat(
        name="eth3d",
        title="ETH3D, ground_truth_depth without a header",
        files=("headerless",),
        size=(6048, 4032),
        invalid_infinity=True,
        note="pairs with the distorted pictures",
    ),
    DepthFormat(
        name="pointodyssey",
        title="PointOdyssey",
        files=_PNG16,
        scale=1000 / 65535,
        invalid=(0,),
        sky=65535,
    ),
    DepthFormat(
        name="dynamicreplica",
        title="Dynamic Replica, float16 in 16 bits",
        files=_PNG16,
        bits="float16",
        invalid=(0,),
    ),
    DepthFormat(
        name="co3d",
        title="CO3D, float16 in 16 bits",
        files=_PNG16,
        bits="float16",
        invalid=(0,),
        needs=("depth-scale",),
        note="‹depth-scale› is scale_adjustment of frame_annotations.jgz",
    ),
    DepthFormat(
        name="mvs-synth",
        title="MVS-Synth",
        files=("EXR",),
        unitless=True,
        note="units of the game",
    ),
    DepthFormat(
        name="bedlam",
        title="BEDLAM and BEDLAM2",
        files=("EXR",),
        scale=1 / 100,
        channels=("Depth", *UNREAL_DEPTH, "*.Depth"),
        sky=_BEYOND_20000,
    ),
    DepthFormat(
        name="urbansyn",
        title="UrbanSyn",
        files=("EXR",),
        scale=1e5,
        mask=Mask(("{stem}_ss.png", "../ss/ss_{number}.png"), "sky", 10),
    ),
    DepthFormat(
        name="synscapes",
        title="Synscapes",
        files=("EXR",),
        channels=("Z",),
        mask=Mask(("{stem}_class.png", "../class/{stem}.png"), "sky", 23),
    ),
    DepthFormat(
        name="3dkenburns",
        title="3D Ken Burns",
        files=("EXR",),
        scale=1 / 1000,
        sky=_BEYOND_20000,
    ),
    DepthFormat(
        name="omniobject3d",
        title="OmniObject3D, last channel",
        files=("EXR",),
        plane=-1,
        sky=65504,
    ),
    DepthFormat(
        name="blendedmvs",
        title="BlendedMVS",
        files=("PFM",),
        invalid=(0,),
        unitless=True,
        note="units of the scene",
    ),
    DepthFormat(
        name="megadepth",
        title="MegaDepth",
        files=("HDF5",),
        channels=("depth",),
        invalid=(0,),
        needs=("depth-scale",),
        note="without a metric scale: ‹depth-scale› says metres of 1",
    ),
    DepthFormat(
        name="eden",
        title="EDEN",
        files=("MATLAB", "HDF5"),
        channels=("Depth",),
        plane=0,
    ),
    DepthFormat(
        name="arkitscenes",
        title="ARKitScenes, WildRGBD, HOI4D, UASOL, and others in millimetres",
        files=_PNG16,
        scale=1 / 1000,
        invalid=(0,),
        note="ARKitScenes: turn both pictures so that the sky is above",
        aliases=("wildrgbd", "hoi4d", "uasol", "arkit", "dp5k", "png-mm"),
    ),
    DepthFormat(
        name="tum",
        title="TUM RGB-D, Bonn, SmartPortraits",
        files=_PNG16,
        scale=1 / 5000,
        invalid=(0,),
        aliases=("bonn", "smartportraits"),
    ),
    DepthFormat(
        name="ibims1",
        title="iBims-1",
        files=_PNG16,
        scale=50 / 65535,
        invalid=(0,),
        sky=65535,
        mask=Mask(
            ("{stem}_mask_invalid.png", "mask_invalid/{stem}.png", "../mask_invalid/{stem}.png"),
            "invalid",
            "zero",
        ),
        note="mask_invalid is true where the depth is valid",
    ),
    DepthFormat(
        name="infinigen",
        title="Infinigen",
        files=("NPY",),
        plane=0,
    ),
    DepthFormat(
        name="scenenet-rgbd",
        title="SceneNet RGB-D",
        files=_PNG16,
        scale=1 / 1000,
        geometry="radial",
        invalid=(0,),
    ),
    DepthFormat(
        name="ros",
        title="ROS, 32FC1 in metres or 16UC1 in millimetres",
        files=(*FLOATS, "16-bit PNG", "integer NPY"),
        invalid=(0,),
        integer_scale=1 / 1000,
    ),
)


ROWS: tuple[DepthFormat, ...] = (*RENDERERS, *DEPTH_DATASETS, *STEREO_DATASETS, *NETWORKS)
FORMATS = {row.name: row for row in ROWS}
NAMES = {name: row for row in ROWS for name in (row.name, *row.aliases)}
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ft": 0.3048}  # metres of 1 in the file
UNIT_WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "ft": "feet"}


def usual_unit(samples: DepthNumbers) -> str | None:
    """The unit that numbers of a type have unless one is set; None if the type has no custom."""
    if samples.type == "16-bit PNG":
        return "mm"
    return None if samples.is_integer else "m"
