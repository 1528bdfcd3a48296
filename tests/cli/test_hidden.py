"""--hidden and the trust map: what lies behind, and where it had to be invented."""

import numpy as np
import pytest
from command_line import (
    HEIGHT,
    WIDTH,
    color_exr,
    depth_exr,
    files_under,
    header,
    photograph,
    read_exr,
    refused,
    render,
    texture,
)

CARD = (slice(4, 12), slice(8, 16))


def scene(folder, stem="a", near=0.1):
    """A near white card, blurred, before a texture at 2 m, in focus."""
    pixels, metres = texture(), np.full((HEIGHT, WIDTH), 2.0, np.float32)
    pixels[CARD], metres[CARD] = 1.0, near
    return color_exr(folder / "rgb" / f"{stem}.exr", pixels), depth_exr(
        folder / "depth" / f"{stem}.exr", metres
    )


def behind(folder, stem="a", red=0.9):
    """Red behind the left half of the card; behind the right half nothing is known."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    metres = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    left = (CARD[0], slice(8, 12))
    pixels[left], metres[left] = (red, 0.0, 0.0), 2.0
    return color_exr(folder / "hidden" / f"{stem}.exr", pixels), depth_exr(
        folder / "hidden_depth" / f"{stem}.exr", metres
    )


def test_hidden_shows_through_where_it_is_known_and_trust_is_a_map_of_shares(tmp_path):
    files, hidden = scene(tmp_path), behind(tmp_path)
    kinds = ("--outputs", "render,trust")
    photograph(*files, "-o", tmp_path / "without", *kinds)
    photograph(*files, "-o", tmp_path / "with", "--hidden", *hidden, *kinds)
    without, known = (read_exr(tmp_path / out / "render" / "a.exr") for out in ("without", "with"))
    more = known["R"].astype(np.float32) - without["R"]
    less = known["G"].astype(np.float32) - without["G"]
    assert more[CARD][:, 0].mean() > 0.02
    assert less[CARD][:, 0].mean() < -0.05
    assert header(tmp_path / "with" / "render" / "a.exr")["defocus:hidden"] == "a.exr a.exr"
    trust, more = (
        read_exr(tmp_path / out / "trust" / "a.exr")["trust"] for out in ("without", "with")
    )
    assert trust.dtype == np.float32
    assert trust[CARD].min() < 0.9
    assert trust[0, 0] == pytest.approx(1.0, abs=1e-5)  # in focus, far from the card
    assert more[CARD][:, 0].mean() > trust[CARD][:, 0].mean() + 0.05


def test_hidden_directories_pair_by_stem(tmp_path):
    for stem in ("a", "b"):
        files, hidden = scene(tmp_path, stem), behind(tmp_path, stem)
    folders = [file.parent for file in (*files, *hidden)]
    photograph(*folders[:2], "-o", tmp_path / "o", "--hidden", *folders[2:])
    assert files_under(tmp_path / "o") == {"render/a.exr", "render/b.exr"}
    scene(tmp_path, "c")
    ran = render(*folders[:2], "-o", tmp_path / "p", "--hidden", *folders[2:])
    refused(ran, 3, "empty", "hidden")


def test_hidden_that_does_not_fit(tmp_path):
    files, out = scene(tmp_path), tmp_path / "o"
    _, deep = behind(tmp_path)
    small = color_exr(tmp_path / "small.exr", texture(5, 4))
    small_depth = depth_exr(tmp_path / "small_depth.exr", np.ones((4, 5), np.float32))
    for hidden, code, at in (
        ((small, small_depth), "wrong-size", small),
        ((small, deep), "wrong-size", deep),
        ((tmp_path / "x", deep), "not-found", "x"),
        ((tmp_path, tmp_path / "rgb"), "empty", "rgb"),
    ):
        refused(render(*files, "-o", out, "--hidden", *hidden), 3, code, at)
    assert not out.exists()
