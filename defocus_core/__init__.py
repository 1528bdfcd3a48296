"""Thin-lens defocus of RGB-D images: pure torch, no files, no prints, no global state.

Lengths are in mm, CoC radii in px, signed: negative nearer than focus, positive beyond.
"""

from __future__ import annotations

from defocus_core.depth.conversion import (
    depth_from_disparity,
    depth_from_logarithm,
    planar_depth,
)
from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.guided_resize import GuidedDepth
from defocus_core.depth.repair import diagnose_depth, repair_depth
from defocus_core.depth.repair_options import DEPTH_REPAIRS, repair_options
from defocus_core.distributions import ATTEMPTS, Distribution, drawn
from defocus_core.engine.picture import shared_fill
from defocus_core.engine.settings import Settings
from defocus_core.engine.shared_fill import SharedFill
from defocus_core.evaluation import baselines, metrics
from defocus_core.evaluation.controllability import (
    STRENGTHS,
    blur_made,
    rank_correlation,
    rises,
)
from defocus_core.evaluation.cost import Cost, cells_bytes, cost, memory_bound
from defocus_core.evaluation.law_checks import Check, Setting
from defocus_core.evaluation.lens_laws import LAWS, verify
from defocus_core.evaluation.metrics import Errors
from defocus_core.evaluation.synthetic_scenes import KINDS as SCENE_KINDS
from defocus_core.evaluation.synthetic_scenes import Scenery, scenery
from defocus_core.fitting.matched_blur import MatchedBlur, fnum_of_strength, matched_blur
from defocus_core.fitting.pair import Fit, fit
from defocus_core.images.clipped_lights import AUTO_LIGHTS, ClippedLights, with_lights
from defocus_core.images.order_statistics import depth_percentile
from defocus_core.images.source import Pixels
from defocus_core.images.views import Views
from defocus_core.inpainting.hidden_layers import HiddenLayer
from defocus_core.inpainting.known_layer import Behind
from defocus_core.layers.ladder import UnreachableTolerance, cheapest_within, quantisation
from defocus_core.layers.quality import QUALITIES
from defocus_core.layers.stacked_samples import Layered
from defocus_core.lens import DefocusLens
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.axial_color import color_offset
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.dual_pixel import DUAL_PIXEL_MODELS, DualPixel
from defocus_core.optics.pupil_field import PupilField
from defocus_core.optics.pupil_image import PupilImage
from defocus_core.optics.sensitivity import Sensitivity, sensitivities
from defocus_core.optics.sensor_noise import with_noise
from defocus_core.random_lens import Lenses, RandomDefocus
from defocus_core.render import render, render_layers
from defocus_core.sequences.motion import Frame, chained
from defocus_core.sequences.seen_behind import seen_behind
from defocus_core.sequences.shot_repair import agreed_repair, repair_through
from defocus_core.sequences.temporal_mean import temporal_mean
from defocus_core.stream import Stream

__all__ = [
    "ATTEMPTS",
    "AUTO_LIGHTS",
    "DEPTH_REPAIRS",
    "DUAL_PIXEL_MODELS",
    "LAWS",
    "QUALITIES",
    "SCENE_KINDS",
    "STRENGTHS",
    "Aperture",
    "Behind",
    "CatEye",
    "Check",
    "ClippedLights",
    "Cost",
    "DefocusLens",
    "DepthRepair",
    "Distribution",
    "DualPixel",
    "Errors",
    "Fit",
    "Frame",
    "GuidedDepth",
    "HiddenLayer",
    "Layered",
    "Lenses",
    "MatchedBlur",
    "Pixels",
    "PupilField",
    "PupilImage",
    "RandomDefocus",
    "Scenery",
    "Sensitivity",
    "Setting",
    "Settings",
    "SharedFill",
    "Stream",
    "UnreachableTolerance",
    "Views",
    "agreed_repair",
    "baselines",
    "blur_made",
    "cells_bytes",
    "chained",
    "cheapest_within",
    "color_offset",
    "cost",
    "depth_from_disparity",
    "depth_from_logarithm",
    "depth_percentile",
    "diagnose_depth",
    "drawn",
    "fit",
    "fnum_of_strength",
    "matched_blur",
    "memory_bound",
    "metrics",
    "planar_depth",
    "quantisation",
    "rank_correlation",
    "render",
    "render_layers",
    "repair_depth",
    "repair_options",
    "repair_through",
    "rises",
    "scenery",
    "seen_behind",
    "sensitivities",
    "shared_fill",
    "temporal_mean",
    "verify",
    "with_lights",
    "with_noise",
]
