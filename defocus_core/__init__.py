"""Thin-lens defocus of RGB-D images, as a library: pictures in files, batches, and their rendering.

Lengths are in mm, CoC radii in px, signed: negative nearer than focus, positive beyond. The import
is light: the module of a name, and torch with it, is imported when the name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from defocus_core.depth.conversion import (
        depth_from_disparity,
        depth_from_logarithm,
        planar_depth,
    )
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.depth.guided_resize import GuidedDepth
    from defocus_core.depth.repair import diagnose_depth, repair_depth
    from defocus_core.depth.repair_options import DEPTH_REPAIRS, repair_options
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
    from defocus_core.optics.aperture import Aperture
    from defocus_core.optics.axial_color import color_offset
    from defocus_core.optics.cat_eye import CatEye
    from defocus_core.optics.distributions import ATTEMPTS, Distribution, drawn
    from defocus_core.optics.dual_pixel import DUAL_PIXEL_MODELS, DualPixel
    from defocus_core.optics.pupil_field import PupilField
    from defocus_core.optics.pupil_image import PupilImage
    from defocus_core.optics.sensitivity import Sensitivity, sensitivities
    from defocus_core.optics.sensor_noise import with_noise
    from defocus_core.renderer.defocus_lens import DefocusLens
    from defocus_core.renderer.engine.picture import shared_fill
    from defocus_core.renderer.engine.settings import Settings
    from defocus_core.renderer.engine.shared_fill import SharedFill
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
    from defocus_core.renderer.inpainting.known_layer import Behind
    from defocus_core.renderer.layers.ladder import (
        UnreachableTolerance,
        cheapest_within,
        quantisation,
    )
    from defocus_core.renderer.layers.quality import QUALITIES
    from defocus_core.renderer.layers.stacked_samples import Layered
    from defocus_core.renderer.random_defocus import Lenses, RandomDefocus
    from defocus_core.renderer.render import render, render_layers
    from defocus_core.renderer.stream import Stream
    from defocus_core.sequences.motion import Frame, chained
    from defocus_core.sequences.seen_behind import seen_behind
    from defocus_core.sequences.shot_repair import agreed_repair, repair_through
    from defocus_core.sequences.temporal_mean import temporal_mean
    from defocus_core.tensors.clipped_lights import AUTO_LIGHTS, ClippedLights, with_lights
    from defocus_core.tensors.order_statistics import depth_percentile
    from defocus_core.tensors.source import Pixels
    from defocus_core.tensors.views import Views

# The names of each module.
_MODULES = {
    "depth.conversion": "depth_from_disparity depth_from_logarithm planar_depth",
    "depth.diagnosis": "DepthRepair",
    "depth.guided_resize": "GuidedDepth",
    "depth.repair": "diagnose_depth repair_depth",
    "depth.repair_options": "DEPTH_REPAIRS repair_options",
    "evaluation": "baselines metrics",
    "evaluation.controllability": "STRENGTHS blur_made rank_correlation rises",
    "evaluation.cost": "Cost cells_bytes cost memory_bound",
    "evaluation.law_checks": "Check Setting",
    "evaluation.lens_laws": "LAWS verify",
    "evaluation.metrics": "Errors",
    "evaluation.synthetic_scenes": "SCENE_KINDS Scenery scenery",
    "fitting.matched_blur": "MatchedBlur fnum_of_strength matched_blur",
    "fitting.pair": "Fit fit",
    "optics.aperture": "Aperture",
    "optics.axial_color": "color_offset",
    "optics.cat_eye": "CatEye",
    "optics.distributions": "ATTEMPTS Distribution drawn",
    "optics.dual_pixel": "DUAL_PIXEL_MODELS DualPixel",
    "optics.pupil_field": "PupilField",
    "optics.pupil_image": "PupilImage",
    "optics.sensitivity": "Sensitivity sensitivities",
    "optics.sensor_noise": "with_noise",
    "renderer.defocus_lens": "DefocusLens",
    "renderer.engine.picture": "shared_fill",
    "renderer.engine.settings": "Settings",
    "renderer.engine.shared_fill": "SharedFill",
    "renderer.inpainting.hidden_layers": "HiddenLayer",
    "renderer.inpainting.known_layer": "Behind",
    "renderer.layers.ladder": "UnreachableTolerance cheapest_within quantisation",
    "renderer.layers.quality": "QUALITIES",
    "renderer.layers.stacked_samples": "Layered",
    "renderer.random_defocus": "Lenses RandomDefocus",
    "renderer.render": "render render_layers",
    "renderer.stream": "Stream",
    "sequences.motion": "Frame chained",
    "sequences.seen_behind": "seen_behind",
    "sequences.shot_repair": "agreed_repair repair_through",
    "sequences.temporal_mean": "temporal_mean",
    "tensors.clipped_lights": "AUTO_LIGHTS ClippedLights with_lights",
    "tensors.order_statistics": "depth_percentile",
    "tensors.source": "Pixels",
    "tensors.views": "Views",
}
_RENAMED = {"SCENE_KINDS": "KINDS"}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import the module of a name that is used for the first time."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_MODULE_OF[name]}")
    value = globals()[name] = getattr(module, _RENAMED.get(name, name))
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


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
