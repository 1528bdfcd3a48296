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
]


@pytest.mark.parametrize("update", [True, False])
@pytest.mark.parametrize("name", NOWHERE)
def test_names_lead_nowhere_but_below_the_goldens(name, update, tmp_path):
    folder, mine = tmp_path / "goldens", tmp_path / "mine"
    folder.mkdir()
    mine.mkdir()
    (folder / "linked").symlink_to(mine)
    with pytest.raises(ValueError, match="below"):
        Golden(folder, update=update).check(IMAGE, name)
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
        Golden(tmp_path, update=update).check(image, "a")


@pytest.mark.parametrize("update", [True, False])
def test_a_name_is_checked_once_in_a_test(update, tmp_path):
    Golden(tmp_path, update=True).check(IMAGE, "a")
    fixture = Golden(tmp_path, update=update)
    fixture.check(IMAGE, "a")
    with pytest.raises(ValueError, match="checked before"):
        fixture.check(IMAGE, "a")
    Golden(tmp_path, update=update).check(IMAGE, "a")  # that of another test


def test_a_bound_that_lets_all_pass_is_refused(tmp_path):
    Golden(tmp_path, update=True).check(IMAGE, "a")
    with pytest.raises(ValueError, match="NaN: it lets all pass"):
        Golden(tmp_path, update=False).check(IMAGE, "a", max=float("nan"))


def test_infinite_values_are_held(tmp_path):
    image = np.full((4, 4), np.inf)
    Golden(tmp_path, update=True).check(image, "a")
