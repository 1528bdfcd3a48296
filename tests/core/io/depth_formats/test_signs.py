"""16 bits without a unit are refused where they look like a named format, and nowhere else."""

import numpy as np
import pytest
from depth_files import png
from depth_reading import decoded
from refusals import refuses


def numbers(size, *, zeros=0.0):
    draw = np.random.default_rng(5)
    values = draw.integers(500, 20000, size[::-1])
    share = draw.random(size[::-1])
    return np.where(share < zeros, 0, values)


SMALL, KITTI = (8, 6), (1242, 375)
LIKELY = [
    ("kitti", "proj_depth/groundtruth/image_02/0000000005.png", numbers(SMALL, zeros=0.8)),
    ("vkitti2", "Scene01/clone/frames/depth/Camera_0/depth_00000.png", numbers(SMALL)),
    ("matterport", "undistorted_depth_images/a_d0_0.png", numbers(SMALL, zeros=0.1)),
    ("tum", "rgbd_dataset_freiburg1_desk/depth/1305031453.374112.png", numbers(SMALL, zeros=0.2)),
    ("cityscapes", "disparity/train/ulm/ulm_000001_000019_disparity.png", numbers(SMALL)),
]


@pytest.mark.parametrize(("name", "place", "values"), LIKELY)
def test_a_likely_format_is_named(name, place, values, tmp_path):
    path = tmp_path / place
    path.parent.mkdir(parents=True, exist_ok=True)
    png(path, values)
    with refuses("unknown-unit") as caught:
        decoded(path)
    assert f"‹depth-format› {name}, or ‹depth-unit› mm" in caught.value.remedy
    assert not np.isnan(decoded(path, depth_unit="mm").metres).any()


@pytest.mark.parametrize(
    ("place", "values"),
    [
        ("a.png", numbers(KITTI)),  # dense, and nothing at the top
        ("a.png", numbers(SMALL, zeros=0.8)),  # sparse, of another size
        ("kitti/a.png", numbers(SMALL)),  # what a network made of it
        ("depth/1305031453.374112.png", numbers(SMALL, zeros=0.2)),  # of any camera
        ("scene0000_00/depth/0.png", numbers(SMALL, zeros=0.2)),
        ("nyu/depth/00001.png", numbers(SMALL, zeros=0.2)),
    ],
)
def test_millimetres_are_read(place, values, tmp_path):
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    read = decoded(png(tmp_path / place, values))
    np.testing.assert_allclose(read.metres, values / 1000, rtol=1e-6)
