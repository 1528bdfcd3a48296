"""What the fixture ``golden`` refuses: names that lead outside, and values that would all pass."""

import numpy as np
import pytest

from defocus_core.pytest_plugin import Golden

IMAGE = np.zeros((4, 4), np.float32)
NOWHERE = [
    "",
    ".",
    "..",
    "/",
    "a/",
    "a//b",
    "../a",
    "a/../../b",
    "/tmp/a",
    "render/../a",
    "linked/a",
    "a.1",
]


@pytest.mark.parametrize("update", [True, False])
@pytest.mark.parametrize("name", NOWHERE)
def test_names_lead_nowhere_but_below_the_goldens(name, update, tmp_path):
    folder, mine = tmp_path / "goldens", tmp_path / "mine"
    folder.mkdir()
    mine.mkdir()
    (folder / "linked").symlink_to(mine)
    with pytest.raises(ValueError, match="below"):
        Golden(folder, update, tmp_path).check(IMAGE, name)
    assert not list(mine.iterdir())


@pytest.mark.parametrize(
    "image",
    [
        *(IMAGE + 1j, IMAGE.astype(np.float64) + 1e39, IMAGE.astype(object), IMAGE.astype("U1")),
        np.zeros((2, 3, 4, 5)),
    ],
)
@pytest.mark.parametrize("update", [True, False])
def test_values_that_a_golden_cannot_hold_are_refused(image, update, tmp_path):
    with pytest.raises(ValueError, match="image must "):
        Golden(tmp_path, update, tmp_path).check(image, "a")


@pytest.mark.parametrize("update", [True, False])
def test_a_name_is_checked_once_in_a_test(update, tmp_path):
    Golden(tmp_path, True, tmp_path).check(IMAGE, "a")
    fixture = Golden(tmp_path, update, tmp_path)
    fixture.check(IMAGE, "a")
    with pytest.raises(ValueError, match="checked before"):
        fixture.check(IMAGE, "a")
    Golden(tmp_path, update, tmp_path).check(IMAGE, "a")  # that of another test


def test_a_bound_that_lets_all_pass_is_refused(tmp_path):
    Golden(tmp_path, True, tmp_path).check(IMAGE, "a")
    with pytest.raises(ValueError, match="max must be a finite number"):
        Golden(tmp_path, False, tmp_path).check(IMAGE, "a", max=float("nan"))


def test_infinite_values_are_held(tmp_path):
    image = np.full((4, 4), np.inf)
    Golden(tmp_path, True, tmp_path).check(image, "a")


def test_integers_are_what_a_screen_shows(tmp_path):
    """8 bits are 0…1, so that bounds of a screen see a picture that was turned."""
    image = np.random.default_rng(0).integers(0, 256, (32, 32, 3), np.uint8)
    Golden(tmp_path, True, tmp_path).check(image, "a", psnr=45)
    Golden(tmp_path, False, tmp_path).check(image, "a", psnr=45)
    rounded = np.clip(image.astype(int) + 1, 0, 255).astype(np.uint8)
    Golden(tmp_path, False, tmp_path).check(rounded, "a")
    for other in (image[::-1, ::-1], image - (image > 1) * np.uint8(2)):
        with pytest.raises(pytest.fail.Exception):
            Golden(tmp_path, False, tmp_path).check(other, "a", psnr=60)
        with pytest.raises(pytest.fail.Exception):
            Golden(tmp_path, False, tmp_path).check(other, "a")


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_a_step_of_its_number_type_is_rounding(dtype, tmp_path):
    image = np.random.default_rng(0).uniform(0, 9, (32, 32)).astype(dtype)
    Golden(tmp_path, True, tmp_path).check(image, "a")
    Golden(tmp_path, False, tmp_path).check(np.nextafter(image, dtype(99)), "a")
    with pytest.raises(pytest.fail.Exception):
        Golden(tmp_path, False, tmp_path).check(image * dtype(1.002), "a")
