"""What is hidden comes before what is visible, beyond it and much more blurred."""

from __future__ import annotations

from defocus_core.renderer.layers.slice_radii import composite_order, octaves

RADII = (-9.0, -5.0, -2.5, -1.0, 0.0, 1.0, 2.5, 3.5, 5.0, 6.0, 9.0, 12.0, 20.0, 30.0)
LAYERS = [0, 1, 2, 3, 4, 5, 6, 6, 7, 7, 8, 8, 9, 10]


def test_octaves_count_from_two_px_on_both_sides_of_focus():
    radii = (-8.0, -4.0, -2.0, -1.9, 0.0, 1.9, 2.0, 3.9, 4.0, 8.0)
    assert octaves(radii) == [-3, -2, -1, 0, 0, 0, 1, 1, 2, 3]


def test_an_octave_comes_before_the_first_layer_that_is_much_more_blurred():
    around, beyond, ahead = composite_order(RADII, LAYERS)
    assert (around, beyond) == (3, 6)
    # up to 4 px before 9 px, for 5 px are too alike; up to 8 px before 20 px; up to 16 before 30
    assert ahead == [(-3, 10), (-2, 9), (-1, 8), (1, 8), (2, 9), (3, 10)]


def test_where_nothing_is_beyond_focus_nothing_comes_before_it():
    assert composite_order((-5.0, -2.5, -1.0, 0.0), [0, 1, 2, 3]) == (2, 4, [])
    assert composite_order((-5.0, -2.5), [0, 1]) == (2, 2, [])
    assert composite_order((0.0, 2.5, 3.5), [0, 1, 1]) == (0, 1, [])
