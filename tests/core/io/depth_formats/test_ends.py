"""Ends of a type, numbers of fewer bits and axes of one entry are read as the file has them."""

import errno
import os

import numpy as np
import pytest
from depth_files import gdepth, npy, png
from depth_reading import decoded
from image_files import save
from optional_libraries import HEIC_MAGIC, heic
from refusals import refuses

from defocus_core import DefocusError, read_depth
from defocus_core.io.read_files import decoding


@pytest.mark.parametrize("dtype", ["uint16", "int32"])
def test_the_end_of_a_type_far_from_all_others_is_a_hole(dtype, tmp_path):
    top = np.iinfo(dtype).max
    values = [[2000, 3000], [top, 4000]]
    path = tmp_path / "a.npy"
    npy(path, values, dtype)
    depth = decoded(path, depth_unit="mm")
    assert depth.invalid.tolist() == [[False, False], [True, False]]
    assert str(top) in depth.warnings[0]
    with refuses("invalid-depth", str(top), path=path):
        read_depth(path, unit="mm", invalid="error")
    filled = decoded(path, depth_unit="mm", invalid="fill")
    assert filled.metres[1].tolist() == [4, 4]


def test_the_end_of_a_type_is_what_user_or_neighbours_say(tmp_path):
    path = png(tmp_path / "a.png", [[2000, 65535]])
    assert decoded(path, sky=65535).metres[0, 1] == np.inf
    named = decoded(path, depth_unit="mm", invalid_value=2000, sky=70000)
    assert named.invalid.tolist() == [[True, False]]
    near = png(tmp_path / "b.png", [[60000, 65535]])
    assert not decoded(near, depth_unit="mm").invalid.any()


@pytest.mark.parametrize(
    ("bits", "dtype"), [(12, np.uint16), (10, np.uint16), (14, np.uint16), (4, np.uint8)]
)
def test_fewer_bits_are_the_numbers_in_the_file(bits, dtype, tmp_path):
    top = 2**bits - 1
    numbers = np.array([[1, top // 3, top]])
    stretched = np.rint(numbers * (np.iinfo(dtype).max / top)).astype(dtype)[..., None]
    path = save(tmp_path / "a.tif", stretched, **{"oiio:BitsPerSample": bits})
    found = decoded(path, depth_unit="mm", sky=1e9).metres
    np.testing.assert_allclose(found, numbers / 1000, rtol=1e-6)
    ends = decoded(path, depth_kind="depth", depth_range=(0.0, 1000.0 * top))
    np.testing.assert_allclose(ends.metres, numbers, rtol=1e-6)


def test_equal_ends_of_a_photograph_are_one_plane(tmp_path):
    data = png(tmp_path / "d.png", [[0, 90], [200, 255]], np.uint8).read_bytes()
    told = {"Format": "RangeInverse", "Near": 2, "Far": 2, "Mime": "image/png", "Units": "m"}
    path = gdepth(tmp_path / "a.jpg", data, **told)
    assert (decoded(path, depth_format="android-gdepth").metres == 2).all()
    photo = tmp_path / "a.heic"
    photo.write_bytes(HEIC_MAGIC)
    with heic(np.full((2, 2), 7, np.uint8), d_min=0.5, d_max=0.5):
        assert (decoded(photo, depth_format="apple-heic").metres == 2).all()


@pytest.mark.parametrize("how", ["far", "fill"])
def test_too_close_takes_the_nearer_neighbour(how, tmp_path):
    path = npy(tmp_path / "a.npy", [[1, -np.inf, 9, np.nan]])
    depth = decoded(path, invalid=how)
    assert depth.metres[0].tolist() == [1, 1, 9, np.inf if how == "far" else 9]


@pytest.mark.parametrize(
    "shape", [(3, 4, 5), (3, 4, 5, 1), (1, 3, 4, 5), (3, 1, 4, 5), (1, 3, 4, 5, 1)]
)
def test_part_picks_a_frame_of_a_stack(shape, tmp_path):
    values = np.arange(60.0).reshape(3, 4, 5) + 1
    path = npy(tmp_path / "a.npy", values.reshape(shape))
    assert decoded(path, part=1).metres.tolist() == values[1].tolist()
    with refuses("ambiguous", "3 frames", path=path):
        decoded(path)


def test_a_range_ends_where_its_rule_is_linear(tmp_path):
    path = png(tmp_path / "a.png", [[0, 128, 255]], np.uint8)
    depth = decoded(path, depth_kind="depth", depth_range=(0.0, 255000.0))
    assert depth.metres[0].tolist() == pytest.approx([0, 128, 255])
    for kind, ends in (("disparity", (0.0, 1.0)), ("depth", (1.0, np.inf))):
        with pytest.raises(DefocusError) as error:
            decoded(path, depth_kind=kind, depth_range=ends)
        assert error.value.code == "out-of-range"


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EAGAIN])
def test_what_the_system_lacks_is_no_fault_of_a_file(number, tmp_path):
    with pytest.raises(DefocusError) as error, decoding(tmp_path / "a.png"):
        raise OSError(number, os.strerror(number))
    assert "damaged" not in error.value.problem
    assert "ulimit" in error.value.remedy
