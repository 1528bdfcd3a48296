"""Formats of networks and phones: one row each."""

from __future__ import annotations

from defocus_core.io.depth_formats.rules import FLOATS, DepthFormat, Mask

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
