"""Luminance and chroma: colour comes back, and what was subsampled is smooth between samples."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from image_files import SCANLINE

from defocus_core.errors import InputError
from defocus_core.io.exr.chroma import weights_of
from defocus_core.io.exr.header import read_headers
from defocus_core.io.images.color import read_color

REC_709 = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709
WIDE = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)  # ACES, SMPTE ST 2065-1


def smooth(height=32, width=48):
    """Colours that change slowly, [3, H, W]."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    waves = (np.sin(x / 9), np.cos(y / 7 + 1), np.sin((x + y) / 11 + 2))
    return np.stack([0.5 + 0.3 * wave for wave in waves])


def chroma_file(path, rgb, weights=REC_709, every=2, **more):
    """A file of Y, RY and BY, of which chroma has a sample every so many pixels."""
    luminance = np.tensordot(weights, rgb, 1)
    planes = {"Y": OpenEXR.Channel(luminance.astype(np.float32), 1, 1)}
    for name, color in (("RY", rgb[0]), ("BY", rgb[2])):
        samples = ((color - luminance) / luminance)[::every, ::every].astype(np.float32)
        room = np.zeros(luminance.shape, np.float32)  # the binding wants one for each pixel,
        room.ravel()[: samples.size] = samples.ravel()  # and writes the first of them
        planes[name] = OpenEXR.Channel(room, every, every)
    OpenEXR.File({**SCANLINE, **more}, planes).write(str(path))
    return path


# The weights of BT.709 are rounded to four digits; cubics err by the fourth power of a wave number.
@pytest.mark.parametrize(("every", "tolerance"), [(1, 1e-4), (2, 2e-3)])
def test_colour_comes_back(every, tolerance, tmp_path):
    rgb = smooth()
    color = read_color(chroma_file(tmp_path / "a.exr", rgb, every=every))
    assert color.channels == ("R", "G", "B")
    assert "luminance and chroma" in color.note
    inside = np.s_[:, 4:-4, 4:-4]
    np.testing.assert_allclose(np.stack(color.planes)[inside], rgb[inside], atol=tolerance)


def test_the_weights_are_those_of_the_primaries(tmp_path):
    plain = read_headers(chroma_file(tmp_path / "a.exr", smooth()))[0]
    assert weights_of(plain, tmp_path) == pytest.approx(REC_709, abs=2e-4)
    said = read_headers(chroma_file(tmp_path / "b.exr", smooth(), chromaticities=WIDE))[0]
    assert weights_of(said, tmp_path) == pytest.approx((0.3440, 0.7282, -0.0721), abs=2e-4)


@pytest.mark.filterwarnings("error")
def test_primaries_of_xyz_have_the_luminance_y(tmp_path):
    xyz = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
    color = read_color(chroma_file(tmp_path / "a.exr", smooth(), (0, 1, 0), chromaticities=xyz))
    np.testing.assert_allclose(color.planes[1], smooth()[1], rtol=1e-6)


LINE = (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.25, 0.25)
DARK = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.0)


@pytest.mark.parametrize("primaries", [LINE, DARK])
@pytest.mark.filterwarnings("error")
def test_primaries_that_span_no_colours_are_refused(primaries, tmp_path):
    file = chroma_file(tmp_path / "a.exr", smooth(), chromaticities=primaries)
    with pytest.raises(InputError) as caught:
        read_color(file)
    assert (caught.value.code, caught.value.path) == ("damaged", str(file))


def test_grey_stays_grey(tmp_path):
    grey = np.broadcast_to(smooth()[:1], (3, 32, 48))
    color = read_color(chroma_file(tmp_path / "a.exr", grey))
    for plane in color.planes:
        np.testing.assert_allclose(plane, grey[0], rtol=1e-5)
