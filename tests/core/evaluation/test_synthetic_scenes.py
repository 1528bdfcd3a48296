"""Scenes made to be timed."""

import pytest
import torch

from defocus_core.evaluation.synthetic_scenes import KINDS, scenery

SIZE = (60, 96)


def radius(kind, r=8.0):
    return scenery(kind, *SIZE, r).signed_radius


@pytest.mark.parametrize("kind", KINDS)
def test_a_scene_is_as_large_and_as_blurred_as_asked_for_each_time(kind):
    image, r = scenery(kind, *SIZE, 8.0)
    assert all(map(torch.equal, (image, r), scenery(kind, *SIZE, 8.0)))
    assert (image.shape, r.shape) == ((3, *SIZE), SIZE)
    maximum = float(r.abs().max())
    assert maximum <= 0.5 if kind == "focus" else 7.5 < maximum <= 8.0
    assert float(image.min()) >= 0.0
    assert float(image.max()) > 1.0 if kind == "lights" else float(image.max()) <= 1.0


def test_four_fifths_of_a_frame_are_in_focus():
    assert float((radius("most").abs() < 0.5).double().mean()) == pytest.approx(0.8, abs=0.02)


def test_a_floor_crosses_the_focus_without_a_step():
    r = radius("floor")
    assert float(r.diff(dim=0).abs().max()) < 0.5
    assert float(r.min()) == pytest.approx(-float(r.max()))


@pytest.mark.parametrize("kind", ["cards", "thin", "lights"])
def test_surfaces_overlap(kind):
    assert float(radius(kind).diff(dim=-1).abs().max()) > 1.5
    if kind == "cards":  # on both sides of the focus
        assert len(radius(kind).unique()) > 6
        assert float(radius(kind).min()) < -6


def test_lights_are_as_dense_at_any_size():
    small, large = (scenery("lights", n, n, 2.0).image.amax(0) > 1 for n in (128, 256))
    assert int(large.sum()) == pytest.approx(4 * int(small.sum()), rel=0.1)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("flor", 9, 9, 1.0), "kind must be one of"),
        (("floor", 0, 9, 1.0), "0"),
        (("floor", 9, 9, -1.0), "radius"),
    ],
)
def test_what_is_no_scene_is_refused(args, words):
    with pytest.raises(ValueError, match=words):
        scenery(*args)
