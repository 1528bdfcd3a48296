"""What the fixture ``golden`` passes, fails and refuses."""

import re

import numpy as np
import pytest
import torch

from defocus_core.pytest_plugin import Golden

IMAGE = np.zeros((4, 4), np.float32)
NOISE = np.random.default_rng(0).random((32, 48, 3), np.float32)
PLANES = torch.from_numpy(NOISE).permute(2, 0, 1)
NOWHERE = [
    *("", ".", "..", "/", "a/", "a//b", "../a", "a/../../b", "/tmp/a", "render/../a"),
    *("linked/a", "a.1"),
]


def fails(folder, image, *, update=False, **bounds):
    """Why an image is not its golden ``a``; nothing if it is."""
    try:
        Golden(folder, update, folder).check(image, "a", **bounds)
    except pytest.fail.Exception as error:
        return str(error)
    return ""


def accept(folder, image=NOISE):
    """The file of a golden that is accepted."""
    assert not fails(folder, image, update=True)
    return folder / "a.exr"


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
    with pytest.raises(ValueError, match=r"^(image|pictures) must "):
        Golden(tmp_path, update, tmp_path).check(image, "a")


@pytest.mark.parametrize(
    "image",
    [
        *(NOISE, NOISE + np.float32(9e-5), NOISE.astype(np.float64)),
        *(PLANES, PLANES[None].clone().requires_grad_()),
    ],
)
def test_what_is_like_the_golden_passes_and_is_not_written(image, tmp_path):
    golden = accept(tmp_path)
    before = golden.read_bytes()
    for update in (False, True):
        assert not fails(tmp_path, image, update=update)
    assert not fails(tmp_path, str(golden))
    assert golden.read_bytes() == before


def test_a_bound_is_proposed_where_no_cause_is_found(tmp_path):
    accept(tmp_path)
    patch = NOISE + np.float32(0.2) * (np.indices((32, 48)).sum(0) < 9)[..., None]
    found = re.search(r"^max=(\S+) lets it pass$", fails(tmp_path, patch), re.M)
    assert not fails(tmp_path, patch, max=float(found[1]))
    assert "lets it pass" not in fails(tmp_path, patch, max=0.01)


def test_bounds_decide(tmp_path):
    accept(tmp_path)
    dimmed = NOISE * np.float32(0.99)
    assert "another exposure: x 0.99" in fails(tmp_path, dimmed)
    assert not fails(tmp_path, dimmed, psnr=40, rel_rmse=0.02)
    assert "fails p99.9>0.001" in fails(tmp_path, dimmed, p999=1e-3)
    with pytest.raises(TypeError, match="takes no brightness"):
        fails(tmp_path, NOISE, brightness=1)


def test_small_values_are_judged_by_their_own_scale(tmp_path):
    small = NOISE * np.float32(8e-5)
    accept(tmp_path, small)
    assert not fails(tmp_path, small)
    assert "empty" in fails(tmp_path, NOISE * 0)
    assert "fails max>8e-09" in fails(tmp_path, NOISE * np.float32(4e-5))


@pytest.mark.parametrize("update", [True, False])
def test_a_name_is_checked_once_in_a_test(update, tmp_path):
    Golden(tmp_path, True, tmp_path).check(IMAGE, "a")
    fixture = Golden(tmp_path, update, tmp_path)
    fixture.check(IMAGE, "a")
    with pytest.raises(ValueError, match="checked before"):
        fixture.check(IMAGE, "a")
    Golden(tmp_path, update, tmp_path).check(IMAGE, "a")  # that of another test


def test_infinite_values_are_held(tmp_path):
    accept(tmp_path, np.full((4, 4), np.inf))


def test_integers_are_what_a_screen_shows(tmp_path):
    """8 bits are 0…1, so that bounds of a screen see a picture that was turned."""
    image = np.random.default_rng(0).integers(0, 256, (32, 32, 3), np.uint8)
    Golden(tmp_path, True, tmp_path).check(image, "a", psnr=45)
    Golden(tmp_path, False, tmp_path).check(image, "a", psnr=45)
    rounded = np.clip(image.astype(int) + 1, 0, 255).astype(np.uint8)
    Golden(tmp_path, False, tmp_path).check(rounded, "a")
    for other in (image[::-1, ::-1], image - (image > 1) * np.uint8(2)):
        assert fails(tmp_path, other, psnr=60)
        assert fails(tmp_path, other)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_a_step_of_its_number_type_is_rounding(dtype, tmp_path):
    image = np.random.default_rng(0).uniform(0, 6e4, (32, 32)).astype(dtype)
    Golden(tmp_path, True, tmp_path).check(image, "a")
    assert not fails(tmp_path, np.nextafter(image, dtype(65504)))
    assert fails(tmp_path, image * dtype(1.002))
