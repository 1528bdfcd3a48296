"""Thumbnails show what is there, however small."""

import numpy as np
import pytest
from image_files import samples_of

from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import PLAIN


def decoded(data, folder):
    file = folder / ("x.png" if data.startswith(b"\x89PNG") else "x.jpg")
    file.write_bytes(data)
    return samples_of(file)


def test_a_lone_pixel_that_differs_is_seen(tmp_path):
    difference = np.zeros((2160, 3840))
    difference[1000, 2000] = 1.0
    shown = decoded(thumbnails.of_difference(difference, 1.0), tmp_path)
    assert shown.max() > 150
    assert np.median(shown) < 10


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_single_precision_are_shown(tmp_path):
    plane = np.linspace(-1e300, 1e300, 64).reshape(8, 8)
    shown = decoded(thumbnails.of_map(plane, thumbnails.ends_of(plane, PLAIN)), tmp_path)
    assert (shown[0, 0, 0], shown[7, 7, 0]) == (0, 255)
    assert decoded(thumbnails.of_difference(np.abs(plane), 1e300), tmp_path)[0, 0].min() > 100


def test_nan_is_magenta(tmp_path):
    plane = np.full((640, 640), 0.25, np.float16)
    plane[300:340, 300:340] = np.nan
    for data in (thumbnails.of_light([plane] * 3, 1.0), thumbnails.of_difference(plane, 1.0)):
        red, green, blue = decoded(data, tmp_path)[160, 160]
        assert min(red, blue) > 220 > 60 > green
