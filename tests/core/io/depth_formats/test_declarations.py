"""What a user says of a depth file decides its depth; what nobody says is asked for by name."""

import math

import numpy as np
import pytest
from depth_files import gdepth, npy, pfm, png
from depth_reading import decoded
from image_files import save
from jobs_files import PictureFiles, Reading
from optional_libraries import HDF5_MAGIC, HEIC_MAGIC, instead
from refusals import refuses

from defocus_core import UsageProblem
from defocus_core.io.depth_formats.table import FORMATS, NAMES
from defocus_core.picture.pair import read as read_both
from defocus_core.picture.take import InputPair

RAMP = np.array([[0, 51, 102], [153, 204, 255]])


def test_names_and_aliases_are_unlike():
    names = [name for row in FORMATS.values() for name in (row.name, *row.aliases)]
    assert len(names) == len(set(names)) == len(NAMES)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_ends_of_a_range_are_those_of_the_type(dtype, tmp_path):
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    share = RAMP / 255 * 0.8  # the file itself has neither end
    path = npy(tmp_path / "a.npy", (share * top).round(6), dtype)
    share = np.load(path).astype(float) / top
    near_far = (2000.0, 50000.0)
    disparity = decoded(path, depth_kind="disparity", depth_range=near_far).metres
    expected = 1 / (1 / 50 + share * (1 / 2 - 1 / 50))
    np.testing.assert_allclose(disparity, expected, rtol=1e-6)
    depth = decoded(path, depth_kind="depth", depth_range=near_far).metres
    np.testing.assert_allclose(depth, 2 + share * 48, rtol=1e-6)


DISPARITY, RANGE = {"depth_kind": "disparity"}, {"depth_range": (1, 2)}


@pytest.mark.parametrize(
    ("numbers", "said", "metres"),
    [
        ([0, 255], {**DISPARITY, "depth_range": (2000.0, math.inf)}, [math.inf, 2]),
        ([0, 255], {**DISPARITY, "depth_range": (50000.0, 2000.0)}, [2, 50]),  # dark is near
        ([1, 4, 0], {**DISPARITY, "depth_scale": 0.5, "doffs": 0.25}, [1 / 0.75, 1 / 2.25, 4]),
        # KITTI's stereo disparity in steps of 1 / 256 px
        (
            [1, 10],
            {**DISPARITY, "depth_scale": 1 / 256, "focal_px": 700.0, "baseline": 500.0},
            [350 * 256, 35 * 256],
        ),
        ([100, 200], {"depth_unit": "cm", "depth_scale": 3}, [3, 6]),
        ([100, 200], {"depth_scale": 0.5}, [50, 100]),
        *(
            ([10], {"depth_unit": unit}, [10 * metres])
            for unit, metres in (("mm", 1e-3), ("cm", 1e-2), ("m", 1), ("ft", 0.3048))
        ),
        ([1, 99, 100], {"depth_unit": "m", "sky": 100}, [1, 99, math.inf]),
        ([1, 2], {**DISPARITY, "depth_scale": 1.0, "sky": 1.0}, [math.inf, 0.5]),
    ],
)
def test_what_is_said_makes_metres(numbers, said, metres, tmp_path):
    path = npy(tmp_path / "a.npy", [numbers], np.uint8)
    np.testing.assert_allclose(decoded(path, **said).metres, [metres], rtol=1e-6)


def test_floats_beyond_0_and_1_have_no_range(tmp_path):
    path = pfm(tmp_path / "a.pfm", np.array([[0.0, 4523.0]]))  # as MiDaS writes
    with refuses("out-of-range", "from 0 to 4523", "‹depth-range›", "‹depth-scale›"):
        decoded(path, depth_kind="disparity", depth_range=(1000.0, 9000.0))
    of_network = decoded(path, depth_format="midas", depth_range=(1000.0, 9000.0))
    np.testing.assert_allclose(of_network.metres, [[9, 1]], rtol=1e-6)
    assert "4523, the greatest of the file, is 1 m" in of_network.note
    metres = decoded(path, depth_format="midas", depth_scale=1e-4, doffs=0.05).metres
    np.testing.assert_allclose(metres, [[1 / 0.05, 1 / 0.5023]])


@pytest.mark.parametrize(
    ("extra", "magic", "library"),
    [("hdf5", HDF5_MAGIC, "h5py"), ("heif", HEIC_MAGIC, "pillow_heif")],
)
def test_a_library_that_is_not_there_is_named_with_its_extra(extra, magic, library, tmp_path):
    path, words = tmp_path / extra, f"pip install 'defocus[{extra}]'"
    path.write_bytes(magic + bytes(64))
    with instead(library, None), refuses("needs-extra", words, path=path):
        decoded(path)


def test_older_matlab_files_are_refused(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(64))
    with refuses("unsupported", "-v7.3, or as NPY", path=tmp_path / "a.mat"):
        decoded(tmp_path / "a.mat")


def test_another_type_of_file_than_the_format_comes_in(tmp_path):
    path = npy(tmp_path / "a.npy", [[1.0]])
    with refuses("wrong-type", "is read as NPY", "16-bit PNG", path=path):
        decoded(path, depth_format="kitti")
    path = png(tmp_path / "rgb.png", np.full((2, 3, 3), 9), np.uint8)  # bits of four channels
    with refuses("wrong-type", "8-bit RGBA", path=path):
        decoded(path, depth_format="tartanair2")


def test_a_mask_of_another_size_is_refused(tmp_path):
    depth, mask = npy(tmp_path / "a.npy", np.ones((2, 3))), tmp_path / "a_mask.npy"
    npy(mask, np.ones((2, 2)))
    with refuses("wrong-size", "2x2 px", "3x2 px", path=mask):
        decoded(depth, depth_format="diode")
    for data in (b"no array", b""):
        mask.write_bytes(data)
        with refuses("damaged", path=mask):
            decoded(depth, depth_format="diode")


TURNS = {3: RAMP[::-1, ::-1], 6: np.rot90(RAMP, -1), 8: np.rot90(RAMP, 1)}


@pytest.mark.parametrize("turn", TURNS)
def test_depth_in_a_photograph_is_turned_with_it(turn, tmp_path):
    image = png(tmp_path / "a.png", RAMP, np.uint8).read_bytes()
    said = {"Format": "RangeLinear", "Near": 1, "Far": 2, "Units": "m"}
    path = gdepth(tmp_path / "a.jpg", image, turn=turn, **said)
    found = decoded(path, depth_format="android-gdepth").metres
    np.testing.assert_allclose(found, 1 + TURNS[turn] / 255, rtol=1e-5)


@pytest.mark.parametrize("turn", [6, 8])
def test_depth_beside_a_photograph_that_is_turned_is_refused(turn, tmp_path):
    photo = save(tmp_path / "a.jpg", np.zeros((*RAMP.shape, 3), np.uint8), Orientation=turn)
    picture = PictureFiles("a", photo, png(tmp_path / "a.png", RAMP + 1, np.uint16))
    with refuses("wrong-size", "Exif", path=picture.depth):
        read_both(InputPair(picture, Reading()))


def test_a_pointer_of_git_lfs_is_named_as_that(tmp_path):
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    for name in ("a.exr", "a.png", "a.npy", "a.heic"):
        (tmp_path / name).write_text(pointer)
        with refuses("wrong-type", "Git LFS pointer", "git lfs pull", path=tmp_path / name):
            decoded(tmp_path / name)


def grey_ramp(height=64, width=96):
    return np.broadcast_to(np.linspace(10, 245, width), (height, width))


def test_grey_of_a_jpeg_of_three_channels_is_grey(tmp_path):
    noise = np.random.default_rng(0).integers(-5, 6, (64, 96, 3))
    noisy = np.clip(grey_ramp()[..., None] + noise, 0, 255).astype(np.uint8)
    path = save(tmp_path / "a.jpg", noisy)
    found = decoded(path, relative=True).metres
    assert np.abs(found - grey_ramp()).max() < 12
    with refuses("unknown-unit", "8 bits", path=path):
        decoded(path)


@pytest.mark.parametrize("quality", [75, 90])
@pytest.mark.parametrize("is_inside", [False, True])
def test_no_depth_of_a_jpeg_lies_beyond_both_surfaces_of_an_edge(is_inside, quality, tmp_path):
    """Of a disc on a slope, before which stands a pole of its own depth."""
    y, x = np.mgrid[:150, :200]
    depth = np.where(np.hypot(y - 80, x - 70) < 50, 195, 30 + x // 8)
    depth[:, 150:156] = 245
    path = save(tmp_path / "z.jpg", np.uint8(depth)[..., None], CompressionQuality=quality)
    if is_inside:
        said = {"Format": "RangeLinear", "Near": 1.0, "Far": 256.0, "Units": "m"}
        path = gdepth(tmp_path / "a.jpg", path.read_bytes(), **said)
    found = decoded(path).metres - 1 if is_inside else decoded(path, relative=True).metres
    assert 29 < found.min() < 35
    assert np.abs(found[:, :140].max() - 195) <= 2
    assert np.abs(found[:, 151:155] - 245).max() < 30, "the pole stays"


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_colours_are_no_depth(suffix, tmp_path):
    drawn = np.stack([grey_ramp(), grey_ramp() / 2, 255 - grey_ramp()], axis=2).astype(np.uint8)
    with refuses("not-one-channel", "R, G, B", "drawn in colours"):
        decoded(save(tmp_path / f"a.{suffix}", drawn), relative=True)


def test_16_bits_from_end_to_end_are_scaled_file_by_file(tmp_path):
    path = png(tmp_path / "a.png", np.linspace(0, 65535, 48).reshape(6, 8), np.uint16)
    with refuses("unknown-unit", "scaled file by file", "‹depth-range› NEAR FAR", path=path):
        decoded(path)
    assert decoded(path, depth_kind="depth", depth_range=(1000.0, 9000.0)).metres[5, 7] == 9
    assert decoded(path, depth_unit="mm").metres[5, 7] == pytest.approx(65.535)


@pytest.mark.parametrize(
    ("said", "code", "field"),
    [
        ({"depth_format": "kitti", "depth_unit": "cm"}, "idle-option", "depth-unit"),
        ({"depth_format": "kitti", "baseline": 65.0}, "idle-option", "baseline"),
        ({"depth_format": "kitti", "depth_kind": "disparity"}, "contradiction", "depth-kind"),
        ({"fov": 60.0}, "idle-option", "fov"),
        ({"geometry": "radial", "depth_kind": "disparity"}, "idle-option", "radial"),
        ({"geometry": "radial", "fov": 60.0, "focal_px": 9.0}, "contradiction", "fov"),
        ({"depth_range": (1, 2)}, "missing-option", "depth-range"),
        ({"depth_range": (1, 1), "depth_kind": "depth"}, "out-of-range", "depth-range"),
        ({**RANGE, "depth_kind": "depth", "depth_scale": 2.0}, "contradiction", "depth-scale"),
        ({**DISPARITY, "depth_unit": "cm"}, "idle-option", "depth-unit"),
    ],
)
def test_what_means_nothing_or_contradicts_is_refused(said, code, field, tmp_path):
    with refuses(code, kind=UsageProblem, field=field):
        decoded(png(tmp_path / "a.png", RAMP), **said)


def test_an_array_of_a_container_is_chosen_by_name_and_a_frame_by_number(tmp_path):
    frames = np.stack([np.full((5, 6), number) for number in (1.0, 2.0, 3.0)])
    np.savez(tmp_path / "a.npz", near=frames[0], far=frames[1], names=np.array(["a"]))
    np.savez(tmp_path / "b.npz", depth=frames)
    assert decoded(tmp_path / "a.npz", depth_channel="far").metres[0, 0] == 2
    assert decoded(tmp_path / "b.npz", part=2).metres[0, 0] == 3
    for name, said, code, fact in (
        ("a.npz", {}, "ambiguous", "‹depth-channel›"),
        ("a.npz", {"depth_channel": "z"}, "no-such-channel", "near, far"),
        ("b.npz", {}, "ambiguous", "3 frames"),
        ("b.npz", {"part": 3}, "no-such-part", ""),
    ):
        with refuses(code, fact):
            decoded(tmp_path / name, **said)


def test_what_the_user_says_wins_over_the_sidecar_which_must_make_sense(tmp_path):
    calib, path = tmp_path / "calib.txt", pfm(tmp_path / "a.pfm", np.ones((2, 3)))
    calib.write_text("cam0=[10 0 1; 0 1 1; 0 0 1]\nbaseline=1000\ndoffs=0\n")
    assert decoded(path, depth_format="middlebury").metres[0, 0] == 10
    said = {"focal_px": 20.0, "baseline": 500.0, "doffs": 1.0}
    assert decoded(path, depth_format="middlebury", **said).metres[0, 0] == 5
    calib.write_text("cam0=[0 0 1; 0 1 1; 0 0 1]\nbaseline=1\n")
    with refuses("malformed", "a.pfm", path=calib):
        decoded(path, depth_format="middlebury")
