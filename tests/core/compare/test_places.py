"""A difference that no cause explains is said by its place, if it has one."""

import numpy as np
import pytest
from elements import write
from image_files import save, to_srgb
from planted_faults import planes, shot

from defocus_core import compare_images

SIZE = (120, 160)
Y, X = np.indices(SIZE)
RADIUS = np.where(X < 50, 0.2, 6.0).astype(np.float32)  # in focus on the left


def light():
    """Fine detail everywhere, darker at the top and with lights of 2 at the bottom."""
    rng = np.random.default_rng(5)
    image = (0.05 + 0.5 * rng.random((*SIZE, 3))) * np.where(Y < 30, 0.01, 1.0)[..., None]
    image[100:110, 20:140] += 1.5
    return image.astype(np.float32)


def blotches():
    """A pattern of both signs that no cause explains: patches of 3 px, of random gains."""
    rng = np.random.default_rng(6)
    gains = rng.choice([-0.3, -0.1, 0.1, 0.3], (SIZE[0] // 3, SIZE[1] // 3 + 1))
    return np.kron(gains, np.ones((3, 3)))[: SIZE[0], : SIZE[1], None]


def compared(folder, where, *, maps=True):
    a = light()
    b = (a * (1 + blotches() * where[..., None])).astype(np.float32)
    more = {"coc": RADIUS} if maps else {}
    files = [
        write(folder / name, planes(side) | more) for name, side in (("a.exr", a), ("b.exr", b))
    ]
    return compare_images(*files)


PLACES = {
    "at silhouettes": abs(X - 49.5) < 2,
    "in highlights": (Y >= 100) & (Y < 110) & (X >= 20) & (X < 140),
    "at the border": (X < 4) | (Y < 4) | (X >= 156) | (Y >= 116),
    "in one region": (X >= 60) & (X < 100) & (Y >= 40) & (Y < 90),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_difference_without_a_cause_has_its_place(name, tmp_path):
    record = compared(tmp_path, PLACES[name] + 0.02)
    finding = record.findings[-1]
    assert (finding.name, finding.code) == (name, name.replace(" ", "-"))
    assert finding.values["share"] > 0.75 > 2 * finding.values["area"]
    assert finding.explained is None


def test_a_difference_that_is_everywhere_has_no_place(tmp_path):
    assert not {*PLACES, "at edges"} & {*names(compared(tmp_path, np.ones(SIZE)))}


def test_silhouettes_are_those_of_a_map_that_lies_beside(tmp_path):
    where = PLACES["at silhouettes"] + 0.02
    assert "at silhouettes" not in names(compared(tmp_path / "render", where, maps=False))
    write(tmp_path / "coc" / "a.exr", {"coc": RADIUS})
    assert "at silhouettes" in names(compared(tmp_path / "render", where, maps=False))


def names(record):
    return [finding.name for finding in record.findings]


def test_without_a_map_silhouettes_are_edges(tmp_path):
    away = np.hypot(X - 70, Y - 60)
    a = np.where(away < 40, 0.6, 0.1)[..., None] * np.ones(3)
    near = abs(away - 40) < 1.5
    b = a * (1 + near[..., None] * blotches())
    files = [
        write(tmp_path / name, planes(side.astype(np.float32)))
        for name, side in (("a.exr", a), ("b.exr", b))
    ]
    assert "at edges" in names(compare_images(*files))


@pytest.mark.parametrize("name", ["spheres", "lights"])
def test_few_pixels_give_no_name_by_chance(name, tmp_path):
    """Of crops of 24 x 16 px, another exposure is named, and another f-number is nothing else."""
    source = shot(name, 0)
    a, wide = source.rendered(), source.rendered(2.0)
    for top, left in np.ndindex(2, 3):
        cut = (slice(16 * top, 16 * top + 16), slice(24 * left, 24 * left + 24))
        files = [
            write(tmp_path / file, planes(side[cut]))
            for file, side in (("a.exr", a), ("wide.exr", wide), ("bright.exr", a * 1.07))
        ]
        blurred, bright = (compare_images(files[0], file) for file in files[1:])
        assert all(said in ("softer", "another CoC") for said in names(blurred)), (top, left)
        assert names(bright) == ["another exposure"]
        stored = [
            save(tmp_path / file, np.rint(to_srgb(side[cut].clip(0, 1)) * 255).astype("u1"))
            for file, side in (("a.png", a), ("raised.png", a + 0.01))
        ]
        assert names(compare_images(*stored)) in ([], ["offset or contrast"])
