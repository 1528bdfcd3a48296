"""Thin-lens defocus of RGB-D images: pure torch, no files, no prints, no global state.

Lengths are in mm, CoC radii in px, signed: negative nearer than focus, positive beyond.
"""

from __future__ import annotations

from defocus_core.aperture import Aperture
from defocus_core.checks import Check, Setting
from defocus_core.cost_model import Cost, cells_bytes, cost, memory_bound
from defocus_core.distributions import ATTEMPTS, Distribution, drawn
from defocus_core.hidden import HiddenLayer
from defocus_core.known import Behind
from defocus_core.lens import DefocusLens
from defocus_core.mending import Mending
from defocus_core.quality import QUALITIES
from defocus_core.random_lens import Lenses, RandomDefocus
from defocus_core.ranks import depth_percentile
from defocus_core.render import render
from defocus_core.slicing import UnreachableTolerance, cheapest_within, quantisation
from defocus_core.source import Pixels
from defocus_core.stream import Stream
from defocus_core.survey import depth_mending
from defocus_core.tiling import TILE
from defocus_core.verification import LAWS, verify
from defocus_core.views import Views

__all__ = [
    "ATTEMPTS",
    "LAWS",
    "QUALITIES",
    "TILE",
    "Aperture",
    "Behind",
    "Check",
    "Cost",
    "DefocusLens",
    "Distribution",
    "HiddenLayer",
    "Lenses",
    "Mending",
    "Pixels",
    "RandomDefocus",
    "Setting",
    "Stream",
    "UnreachableTolerance",
    "Views",
    "cells_bytes",
    "cheapest_within",
    "cost",
    "depth_mending",
    "depth_percentile",
    "drawn",
    "memory_bound",
    "quantisation",
    "render",
    "verify",
]
