"""Thin-lens defocus of RGB-D images: pure torch, no files, no prints, no global state.

Lengths are in mm, CoC radii in px, signed: negative nearer than focus, positive beyond.
"""

from __future__ import annotations

from defocus_core.aperture import Aperture
from defocus_core.hidden import HiddenLayer
from defocus_core.lens import DefocusLens
from defocus_core.quality import QUALITIES
from defocus_core.random_lens import RandomDefocus, RandomlyDefocused
from defocus_core.render import Rendering, render
from defocus_core.slicing import UnreachableTolerance, cheapest_within, quantisation

__all__ = [
    "QUALITIES",
    "Aperture",
    "DefocusLens",
    "HiddenLayer",
    "RandomDefocus",
    "RandomlyDefocused",
    "Rendering",
    "UnreachableTolerance",
    "cheapest_within",
    "quantisation",
    "render",
]
