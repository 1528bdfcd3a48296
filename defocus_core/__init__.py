"""Thin-lens defocus of RGB-D images: pure torch, no files, no prints, no global state.

Lengths are in mm, CoC radii in px, signed: negative nearer than focus, positive beyond.
"""

from __future__ import annotations

from defocus_core.aperture import Aperture
from defocus_core.distributions import ATTEMPTS, Distribution, drawn
from defocus_core.hidden import HiddenLayer
from defocus_core.lens import DefocusLens
from defocus_core.quality import QUALITIES
from defocus_core.random_lens import Lenses, RandomDefocus
from defocus_core.ranks import depth_percentile
from defocus_core.render import render
from defocus_core.slicing import cheapest_within, quantisation
from defocus_core.stream import Stream
from defocus_core.views import Views

__all__ = [
    "ATTEMPTS",
    "QUALITIES",
    "Aperture",
    "DefocusLens",
    "Distribution",
    "HiddenLayer",
    "Lenses",
    "RandomDefocus",
    "Stream",
    "Views",
    "cheapest_within",
    "depth_percentile",
    "drawn",
    "quantisation",
    "render",
]
