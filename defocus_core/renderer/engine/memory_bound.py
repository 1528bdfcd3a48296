"""Upper bound of the memory of a rendering, computed from its plan."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.renderer.compiled.carried import by_loops, bytes_of_loops
from defocus_core.renderer.engine.frame import SharedFrame, corner_views
from defocus_core.renderer.engine.plan import copies_of_tile
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.tensors.box import regions
from defocus_core.tensors.device_plan import launches_cost

# Bytes of the program's own structures, and of the tile of each thread.
_FIXED, _OF_THREAD = 10e6, 24e6
# Copies of a region in memory while it is computed: of its pixels, of its hidden surfaces, and of
# its left and right views.
_COPIES, _HIDDEN_COPIES, _VIEW_COPIES = 9, 3, 3
# Copies of the picture while it is surveyed, of one channel; and while its coarser resolutions for
# hidden surfaces are made, and then held.
_SURVEYED, _MADE, _HELD = 6, 3, 1.2
# Copies of a region of each layer, of all windows that are sorted and sliced.
_COPIES_OF_LAYER = 8


def memory_bound(renderer: Renderer, threads: int) -> float:
    """Upper bound of the memory in bytes that rendering takes, without its input and output."""
    if renderer.back == "torch":
        return _bound_of_torch(renderer, threads)
    content, settings = renderer.frame.content, replace(renderer.frame.settings, threads=threads)
    others = not by_loops(renderer.in_focus.surface)
    options = {"edges": content.edges, "lights": content.highlights, "others": others}
    return bytes_of_loops(renderer.size, settings, **options)


def _bound_of_torch(renderer: Renderer, threads: int) -> float:
    """`memory_bound` for the torch back, which renders region by region."""
    frame, channels = renderer.frame, renderer.in_focus.surface.image.shape[0]
    size = frame.dtype.itemsize
    sample = (channels + 1) * size
    of_thread = _OF_THREAD
    if launches_cost(renderer.in_focus.reaching.device):
        threads = 1
        area = max(tile.area for tile in frame.grid.tiles)
        copies = copies_of_tile(frame.slices.visible.layers)
        of_thread = float(area * sample * len(frame.division.parts) * copies)
    pixels = frame.box.area
    grids = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    copies = (
        _COPIES + _HIDDEN_COPIES * frame.content.edges + _VIEW_COPIES * frame.settings.left_right
    )
    if renderer.in_focus.layers is not None:
        copies += _COPIES_OF_LAYER * len(renderer.in_focus.layers.colors)
    region = max(grid.box.grown(frame.margin, frame.box).area for grid in grids) * sample * copies
    result = max(grid.box.area for grid in grids) * (channels * frame.views + 1) * size
    coarse = pixels * sample * frame.content.edges
    versions = max(1, len(corner_views(frame, frame.box)))
    spectra = 2 * _bytes_of_spectra(frame) * versions
    repaired = pixels * size
    whole = _FIXED + spectra + repaired + _bytes_of_layers(renderer)
    computed = _HELD * coarse + threads * of_thread + region + 2 * result  # tiles, then joined
    return whole + max(_SURVEYED * pixels * size, _MADE * coarse, computed)


def _bytes_of_layers(renderer: Renderer) -> float:
    """Bytes of the layers of a scene, stacked and flattened; 0 if it has none."""
    layered = renderer.in_focus.layers
    if layered is None:
        return 0.0
    count, channels, height, width = layered.colors.shape
    sizes = (layered.colors, channels), (layered.signed_radius, 1), (layered.coverage, 1)
    pixel = sum(count * many * kept.dtype.itemsize for kept, many in sizes)
    return float(height * width * (pixel + (channels + 3) * layered.dtype.itemsize))


def _bytes_of_spectra(frame: SharedFrame) -> float:
    """Bytes of the spectra of the kernels of all slices, visible and hidden."""
    slices, invented = frame.slices, frame.slices.invented
    hidden = invented.windows[:: invented.stride] if frame.content.edges else []
    sizes = (window.size for window in [*slices.visible.windows, *hidden] if window.margin)
    return float(
        sum(
            2 * h * (w // 2 + 1) * len(frame.division.parts) * frame.dtype.itemsize
            for h, w in sizes
        )
    )
