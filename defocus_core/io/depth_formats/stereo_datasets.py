"""Formats of data sets that store the disparity of two cameras: one row each."""

from __future__ import annotations

from defocus_core.io.depth_formats.rules import DepthFormat

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
