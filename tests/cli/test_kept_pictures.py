"""Nothing replaces what another command made: other lenses, names, views, and lone files."""

import numpy as np
import pytest
from command_line import (
    LENS,
    depth_exr,
    files_under,
    pair,
    photograph,
    read_exr,
    refused,
    render,
    run,
    succeed,
    texture,
)
from elements import write

OTHER = {"focus": ("--focus", "3m"), "fnumber": ("--fnumber", "8"), "blades": ("--blades", "5")}
MAPS = ("--outputs", "coc")


def another(name):
    """The options of the lens with another value of one of them."""
    base = dict(zip(LENS[::2], LENS[1::2], strict=True))
    option, value = OTHER[name]
    return tuple(word for pair in (base | {option: value}).items() for word in pair)


@pytest.mark.parametrize("name", OTHER)
def test_another_lens_replaces_no_picture(name, tmp_path, out):
    files = pair(tmp_path)
    photograph(*files, "-o", out, *MAPS)
    before = (out / "coc/a.exr").read_bytes()
    refused(run("render", *another(name), *files, "-o", out, *MAPS), 3, "exists", "a.exr")
    assert run("render", *another(name), *files, "-o", out, *MAPS, "--dry-run").code == 3
    assert (out / "coc/a.exr").read_bytes() == before
    succeed("render", *another(name), *files, "-o", out, *MAPS, "--overwrite")
    assert (out / "coc/a.exr").read_bytes() != before


VIEWS = {"multiView": ["left", "right"]}


def test_each_view_is_rendered_and_named(tmp_path, out):
    left, right = (texture(seed=seed) for seed in (1, 2))
    planes = {
        f"{view}.{c}": pixels[..., k]
        for view, pixels in (("left", left), ("right", right))
        for k, c in enumerate("RGB")
    }
    color, depth = write(tmp_path / "a.exr", planes, **VIEWS), depth_exr(tmp_path / "z.exr")
    photograph(color, depth, "-o", out, "--outputs", "image", "--view", "left,right")
    for view, pixels in (("left", left), ("right", right)):
        written = read_exr(out / f"image/a_{view}.exr")["R"]
        np.testing.assert_allclose(written, pixels[..., 0], atol=1e-3)


@pytest.mark.parametrize(
    ("name", "options"),
    [("p.png", ()), ("p.tif", ("--outputs", "coc")), ("p.exr", ("--outputs", "left"))],
)
def test_a_file_is_one_picture_without_a_journal(name, options, tmp_path, out):
    files = pair(tmp_path)
    photograph(*files, "-o", out / name, *options)
    assert files_under(out) == {name}
    assert not (out / "journal.jsonl").exists()
    refused(render(*files, "-o", out / name, *options), 3, "exists", out / name)
    photograph(*files, "-o", out / name, *options, "--overwrite")
