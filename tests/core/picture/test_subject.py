"""The subject that a picture is focused on where nobody says it."""

import numpy as np
import pytest
from depth_reading import depth_of

from defocus_core.picture.subject import FoundPixel, subject_of, surface_of, white_is_near

RELATIVE = {"is_radius": True, "is_relative": True}


def found(numbers, **kind):
    depth = depth_of(numbers, **kind)
    subject = subject_of(depth)
    return float(depth.metres[subject.y, subject.x])


def layers(share, *, near=200, nearest=255):
    """A far plane; before it, in the middle half, a surface of a share, and leaves that are nearer
    still, but at the upper border."""
    numbers = np.full((80, 100), 10.0)
    numbers[20:60, 25 : 25 + round(50 * share)] = near
    numbers[:10] = nearest
    return numbers


@pytest.mark.parametrize(("share", "focus"), [(0.2, 200), (0.06, 10)])
def test_it_is_the_nearest_surface_of_a_twentieth_of_the_picture(share, focus):
    assert found(layers(share), **RELATIVE) == focus
    assert found(-layers(share), **RELATIVE, inverted=True) == -focus
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
    assert found(numbers, **RELATIVE) == pytest.approx(200, abs=14)


def person(soft=0.0):
    """A plane at 10; before it a head of 190 to 199 upon a body of 200 to 214, soft at its rim; and
    beside them a wall at 170."""
    y, x = np.mgrid[:200, :300]
    inside = np.minimum.reduce([x - 100, 200 - x, y - 20, np.where(y < 80, 40 - abs(x - 150), 99)])
    coverage = np.clip(inside / (soft or 1e-3) + 0.5, 0, 1)
    numbers = 10 + coverage * (180 + np.minimum(y - 20, 80) * 0.3)
    numbers[:, 240:] = 170
    return np.round(numbers)


@pytest.mark.parametrize("soft", [0.0, 6.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_surface_in_focus_ends_at_its_rim_and_at_other_surfaces(soft, sign):
    depth = depth_of(sign * person(soft), **RELATIVE, inverted=sign < 0)
    low, high = sorted(abs(end) for end in surface_of(depth, subject_of(depth)))
    assert (low, high) == (pytest.approx(191, abs=5), 214)
    assert surface_of(depth, FoundPixel(280, 100, depth.size)) is None, "the wall has one number"


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf])
def test_holes_do_not_change_what_is_in_focus(hole):
    numbers = person()
    numbers[150:170, 110:130] = hole
    depth = depth_of(numbers, **RELATIVE)
    assert surface_of(depth, subject_of(depth)) == (191, 214)
    empty = depth_of(numbers[150:170, 110:130], **RELATIVE)
    assert surface_of(empty, subject_of(empty)) is None


def test_of_a_floor_15_percent_of_the_numbers_are_in_focus():
    floor = np.linspace(0, 255, 200)[:, None].repeat(300, 1)
    low, high = surface_of(depth_of(floor, **RELATIVE), FoundPixel(150, 120, (300, 200)))
    assert low - 1e-3 <= floor[120, 0] <= high
    assert high - low == pytest.approx(0.15 * 255, abs=2.6)


def test_a_face_that_takes_a_third_of_the_numbers_is_in_focus_as_a_whole():
    y, x = np.mgrid[:200, :300]
    off = np.hypot(x - 150, y - 100)
    depth = depth_of(np.where(off < 60, 255 - 80 * off / 60, 10.0), **RELATIVE)
    low, high = surface_of(depth, subject_of(depth))
    assert (low, high) == pytest.approx((175, 255), abs=6)


def test_the_subject_is_not_on_the_ramp_of_an_edge():
    numbers = np.full((200, 300), 10.0)
    numbers[60:140, 110:150], numbers[60:140, 150], numbers[60:140, 151:191] = 190, 195, 200
    assert found(numbers, **RELATIVE) in (190, 200), "195 is its median"


def before_a_wall(*boxes):
    """Disparity of a wall at 20, and of boxes before it that lean by 10: (top, left, number)."""
    numbers = np.full((200, 300), 20.0)
    for top, left, number in boxes:
        numbers[top:190, left : left + 60] = number + np.linspace(0, 10, 190 - top)[:, None]
    return numbers


BOXES = {
    "in the middle": (before_a_wall((50, 120, 190)), (50, 120, 190, 180)),
    "off the middle": (before_a_wall((50, 180, 190)), (50, 180, 190, 240)),
    "beyond the middle half": (before_a_wall((20, 235, 190)), (20, 235, 190, 295)),
    "two persons": (before_a_wall((50, 80, 190), (70, 160, 130)), (50, 80, 190, 140)),
    "one half behind the other": (
        before_a_wall((50, 120, 130), (70, 160, 190)),
        (70, 160, 190, 220),
    ),
    "a table below": (
        np.maximum(before_a_wall((50, 120, 150)), np.where(np.arange(200) > 180, 250, 0)[:, None]),
        (50, 120, 181, 180),
    ),
}


@pytest.mark.parametrize("is_black_near", [False, True])
@pytest.mark.parametrize("name", BOXES)
def test_the_pixels_in_focus_are_those_of_the_subject(name, is_black_near):
    numbers, box = BOXES[name]
    depth = depth_of(-numbers if is_black_near else numbers, **RELATIVE, inverted=is_black_near)
    low, high = surface_of(depth, subject_of(depth))
    rows, columns = np.nonzero((depth.metres >= low) & (depth.metres <= high))
    assert (rows.min(), columns.min(), rows.max() + 1, columns.max() + 1) == pytest.approx(
        box, abs=2
    )


def person_on_a_floor(column):
    """Disparity of a floor below a far wall, and of a person who stands on it."""
    rows = np.linspace(0, 1, 90)[:, None]
    numbers = np.broadcast_to(np.maximum(rows - 0.4, 0.02) * 200, (90, 120)).copy()
    numbers[25:80, column : column + 25] = 110
    return numbers


@pytest.mark.parametrize("column", [4, 20, 48, 80, 92])
def test_who_stands_on_a_floor_is_found_wherever_that_is(column):
    assert found(person_on_a_floor(column), **RELATIVE) == 110


SCENES = {
    "a person in the middle": person_on_a_floor(48),
    "a person off the middle": person_on_a_floor(8),
    "two persons": np.maximum(person_on_a_floor(15), person_on_a_floor(80)),
    "a head before a wall": np.pad(np.full((60, 50), 200.0), ((30, 0), (35, 35))) + 20,
    "a street under a sky": np.repeat(np.linspace(0, 255, 90)[:, None] ** 2 / 255, 120, 1),
    "a cup on a table": np.pad(np.full((40, 30), 220.0), ((30, 20), (45, 45)))
    + np.pad(np.full((20, 120), 240.0), ((70, 0), (0, 0))),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_bottom_and_the_middle_tell_which_end_is_near(name):
    numbers = SCENES[name]
    assert white_is_near(depth_of(numbers, **RELATIVE)) > 0.15
    assert white_is_near(depth_of(255 - numbers, **RELATIVE)) < -0.15
