"""The subject that a picture is focused on where nobody says it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from defocus_core.io.depth_formats.depth import Depth
from defocus_core.picture.subject import subject_of


def found(numbers, **kind):
    depth = Depth(np.asarray(numbers, np.float32), Path("z.exr"), "Z", "", **kind)
    subject = subject_of(depth)
    return float(depth.metres[subject.y, subject.x])


def layers(share, *, near=200, nearest=255):
    """A far plane; before it, in the middle half, a surface of a share, and a border that is
    nearer still, but outside."""
    numbers = np.full((80, 100), 10.0)
    numbers[20:60, 25 : 25 + round(50 * share)] = near
    numbers[:15] = nearest
    return numbers


@pytest.mark.parametrize(("share", "focus"), [(0.1, 200), (0.06, 10)])
def test_it_is_the_nearest_surface_of_a_twelfth_of_the_middle(share, focus):
    relative = {"is_radius": True, "is_relative": True}
    assert found(layers(share), **relative) == focus
    assert found(-layers(share), **relative, inverted=True) == -focus
    assert found(1 / layers(share)) == pytest.approx(1 / focus)


def test_it_is_found_in_disparity_and_sky_is_far():
    metres = np.full((80, 100), np.inf)
    metres[:, 30:50] = 4
    metres[40:50, 40:50] = 2.0
    assert found(metres) == 4, "100 of 2000 pixels are too few"
    metres[30:50, 40:50] = 2.0
    assert found(metres) == 2


@pytest.mark.parametrize("seed", range(3))
def test_a_thick_surface_is_one_and_noise_before_it_none(seed):
    rng = np.random.default_rng(seed)
    numbers = layers(0.3) + rng.uniform(-14, 14, (80, 100))
    numbers[rng.random((80, 100)) < 0.01] = 250
    kind = {"is_radius": True, "is_relative": True}
    assert found(numbers, **kind) == pytest.approx(200, abs=14)


def test_any_depth_has_a_subject():
    kind = {"is_radius": True, "is_relative": True}
    assert found(np.full((1, 1), 7), **kind) == 7
    assert found(np.linspace(0, 1, 64 * 64).reshape(64, 64), **kind) > 0.5
    assert np.isinf(found(np.full((9, 9), np.inf)))
