"""The renderer behind `render`, for laws of its tiles and of its repair of depth."""

from defocus_core.allowed_values import QUALITIES as QUALITIES
from defocus_core.depth.diagnosis import diagnosed
from defocus_core.renderer.compiled import carried
from defocus_core.renderer.compiled.alone import views_alone
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Surface, with_hidden
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors.box import TILE as TILE

HAS_LOOPS = carried.available()
NEEDS_LOOPS = {
    "condition": not HAS_LOOPS,
    "reason": "not on this system: Numba, for the compiled back",
}


def renderer_of(image, radius, *, hidden=None, **settings):
    """The renderer of a picture [C, H, W] of radii [H, W] px."""
    return Renderer(with_hidden(Surface(image, radius), hidden), Settings(**settings))


def alone_of(image, radius, **settings):
    """The views by compiled loops alone; None if torch must decide."""
    return views_alone(Surface(image, radius), Settings(**settings))


def repair_of(radius, infinity=None, *, threads=1):
    """The repair that radii [H, W] px need, by the radii alone."""
    return diagnosed(radius, infinity, threads=threads)
