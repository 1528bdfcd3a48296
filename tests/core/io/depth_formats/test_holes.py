"""Pixels without depth are filled from the farther neighbour, or become sky."""

import numpy as np
import pytest
from depth_files import npy
from depth_reading import decoded
from refusals import refuses

from defocus_core.io.depth_formats.depth import fill_from_farther

INF, NAN = np.inf, np.nan


@pytest.mark.parametrize(
    ("rows", "filled"),
    [
        ([[1, NAN, 0, 5, -1]], [[1, 5, 5, 5, 5]]),  # the farther of the neighbours in the row
        ([[NAN, 3, NAN, 2]], [[3, 3, 3, 2]]),
        ([[2, NAN, INF]], [[2, INF, INF]]),  # sky is the farthest
        # a row without depth: the farther of the rows beside it
        ([[0, 0], [1, 9], [0, 0], [0, 0], [5, 2]], [[1, 9], [1, 9], [5, 9], [5, 9], [5, 2]]),
        ([[1, 2], [3, 4]], [[1, 2], [3, 4]]),
    ],
)
def test_a_hole_takes_the_farther_of_its_neighbours(rows, filled):
    metres = np.array(rows, np.float32)
    fill_from_farther(metres, metres > 0)
    assert metres.tolist() == filled


@pytest.mark.parametrize(
    ("invert", "how", "found"),
    [
        (None, "far", [[3, -1, 1], [-1, 2, 2], [-1, -1, 0]]),
        (None, "fill", [[3, 1, 1], [2, 2, 2], [-1, -1, 0]]),
        ("on", "far", [[3, 3, 1], [3, 2, 2], [3, -1, 0]]),
        ("on", "fill", [[3, 3, 1], [2, 2, 2], [-1, -1, 0]]),
    ],
)
def test_of_relative_disparity_the_farthest_number_is_far(invert, how, found, tmp_path):
    path = npy(tmp_path / "a.npy", [[3.0, NAN, 1.0], [INF, 2.0, 2.0], [NAN, -1.0, 0.0]])
    reading = {"invalid": how, "relative": True, "invert": invert}
    assert decoded(path, **reading).metres[:].tolist() == found
    none = npy(tmp_path / "b.npy", [[NAN, NAN]])
    with refuses("invalid-depth", path=none):
        decoded(none, **reading)


@pytest.mark.parametrize(("how", "value"), [("far", INF), ("fill", 3.0)])
def test_replaced_pixels_are_counted_and_told(how, value, tmp_path):
    path = npy(tmp_path / "a.npy", [[3.0, 0.0], [NAN, 2.0]])
    depth = decoded(path, invalid=how)
    assert not depth.invalid.any()
    replaced = depth.metres[:][[0, 1], [1, 0]]
    assert replaced.tolist() == [value, 2.0 if how == "fill" else value]
    assert depth.replaced == 2
    words = {"far": "taken as infinitely far", "fill": "filled from the farther neighbour"}[how]
    assert f"2 invalid pixels {words}" in depth.note
    assert f"a.npy: 2 invalid pixels {words}" in depth.warnings
