"""Counts of the work of a rendering, `Views.stats`, as lines for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

# What is counted, of what, and in which words; what a renderer does not count is not told.
_LINES = (
    ("slice_tiles_done", "slice_tiles", "steps of slice x tile done"),
    ("slice_tiles_blurred", "slice_tiles", "of them blurred, the others copied"),
    ("slice_tiles_reduced", "slice_tiles", "of them at reduced resolution"),
    ("slice_tiles_culled", "slice_tiles", "steps culled, with nothing left for them to fill"),
    ("layer_pixels_done", "layer_pixels", "pixels of layers, within the rectangles they lie in"),
    ("pixels_copied", "pixels", "pixels copied, where nothing is blurred"),
    ("pixels_clamped", "pixels", "pixels of left or right below 0, made 0"),
    ("tiles_culled", "tiles", "tiles whose hidden slices were culled so"),
    ("tiles_with_hidden", "tiles", "tiles behind whose surface something was invented"),
)


def lines(stats: Mapping[str, float]) -> Iterator[str]:
    """A line for each count, like ``216 of 648   33 %  steps of slice x tile done``."""
    if not stats:
        yield "  nothing was rendered: maps alone need no slices"
        return
    yield f"  {stats['slices']:.0f} slices, {stats['tiles']:.0f} tiles"
    told = [(stats[n], stats[of], words) for n, of, words in _LINES if n in stats and stats.get(of)]
    width = max(len(f"{all_of_them:.0f}") for _, all_of_them, _ in told)
    for count, all_of_them, words in told:
        share = 100 * count / all_of_them
        yield f"  {count:>{width}.0f} of {all_of_them:<{width}.0f} {share:>4.0f} %  {words}"
