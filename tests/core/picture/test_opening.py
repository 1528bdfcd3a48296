"""The opening: pictures of it that are none are refused, and a blur in px has its look."""

import math

import numpy as np
import pytest
from image_files import save
from jobs_files import lens_values
from refusals import refuses

from defocus_core.picture import opening
from defocus_core.picture.radii import color_offsets


def test_a_picture_too_wide_for_a_pupil_is_not_decoded(tmp_path):
    pixels = np.random.default_rng(0).integers(256, size=(1, 5000, 1), dtype=np.uint8)
    path = save(tmp_path / "wide.png", pixels)
    path.write_bytes(path.read_bytes()[:2500])  # to decode it is to find it damaged
    with refuses("malformed", "1 × 1 × 5000", path=tmp_path / "wide.png"):
        opening.pupil_image(tmp_path / "wide.png")


@pytest.mark.parametrize("size", [(300, 200), (640, 480)])
def test_a_blur_in_px_has_the_rim_of_a_lens_of_50_mm_and_axial_colour_as_a_share(size):
    look = {"cat_eye": (1.05, 1.5), "axial_color": (0.05, -0.1)}
    blur = lens_values(math.nan, math.nan, None, blur=40.0, **look)
    lens = opening.cat_eye_of(lens_values(50.0, 1.4, 2000.0, cat_eye=(1.05, 1.5)), (300, 200))
    assert opening.cat_eye_of(blur, size) == lens
    assert color_offsets(blur, size) == (-2.0, 4.0)


@pytest.mark.parametrize("height", [1, 2, 30, 300, 7000])
def test_the_distance_that_is_proposed_for_a_rim_is_one_that_it_takes(height):
    def looking(distance):
        lens = lens_values(8.0, 1.4, 2000.0, cat_eye=(1.05, distance))
        return opening.cat_eye_of(lens, (300, height))

    with refuses("malformed") as caught:
        looking(5.0)
    looking(float(caught.value.remedy.split()[4]))
