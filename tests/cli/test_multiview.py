"""The kind multiview: left and right as the two views of one EXR file."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
from command_line import HEIGHT, LENS, WIDTH, files_under, header, pair, read_exr, run, succeed

NEAR = (*LENS[:4], "--focus", "1m", "--sensor-width", "4mm")


def render(tmp_path, out, *args):
    return run("render", *pair(tmp_path), "-o", tmp_path / out, *NEAR, *args)


def test_left_and_right_are_the_views_of_one_file(tmp_path):
    apart = render(tmp_path, "apart", "--outputs", "render,left,right")
    one = render(tmp_path, "one", "--outputs", "render,multiview", "--preview")
    assert apart.code == one.code == 0, one.err
    assert files_under(tmp_path / "one") == {
        *("multiview/a.exr", "multiview/a.preview.png", "render/a.exr", "render/a.preview.png")
    }
    file = tmp_path / "one" / "multiview" / "a.exr"
    assert header(file)["multiView"] == ["left", "right"]
    both = read_exr(file)
    for view, prefix in (("left", ""), ("right", "right.")):
        alone = read_exr(tmp_path / "apart" / view / "a.exr")
        for name in "RGB":
            np.testing.assert_array_equal(both[f"{prefix}{name}"], alone[name])
    assert np.abs(both["R"].astype("f") - both["right.R"]).max() > 0.05
    preview = oiio.ImageBuf(str(tmp_path / "one" / "multiview" / "a.preview.png")).spec()
    assert (preview.width, preview.height) == (2 * WIDTH, HEIGHT)


def test_the_file_is_read_by_its_views_again(tmp_path):
    assert render(tmp_path, "one", "--outputs", "multiview").code == 0
    file = tmp_path / "one" / "multiview" / "a.exr"
    depth = tmp_path / "depth" / "a.exr"
    again = tmp_path / "again"
    arguments = ("--focal-length", "1mm", "--fnumber", "999", "--focus", "inf")
    succeed("render", file, depth, "-o", again, *arguments, "--view", "right")
    seen, both = read_exr(again / "render" / "a.exr"), read_exr(file)
    assert set(seen) == set("RGB")
    np.testing.assert_allclose(seen["G"].astype("f"), both["right.G"], atol=1e-3)


def test_it_is_an_exr_whatever_the_format_of_images(tmp_path):
    ran = render(tmp_path, "o", "--outputs", "render,multiview", "--format", "png")
    assert ran.code == 0, ran.err
    assert files_under(tmp_path / "o") == {"render/a.png", "multiview/a.exr"}
