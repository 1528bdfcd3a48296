"""Views of EXR files, as their attributes, parts and channels name them."""

import numpy as np
import OpenEXR
import pytest
from elements import write
from image_files import SCANLINE, random_planes
from refusals import refuses

from defocus_core import read_color
from defocus_core.io.exr.channel_choice import in_view, views_of
from defocus_core.io.exr.header import read_headers

# One part of two views, the default one right: plain channels are its own, disparity is no view's.
ONE_PART = (
    *("R", "G", "B", "A", "Z", "left.R", "left.G", "left.B", "left.A", "left.Z"),
    *("forward.left.u", "forward.right.u", "disparityL.x"),
)
TWO_VIEWS = {name: np.full((4, 6), index, np.float16) for index, name in enumerate(ONE_PART)}


def several_parts(path, parts):
    """Parts of RGBA or Z by name, each with its view."""
    made = []
    for name, (channels, view) in parts.items():
        said = {"name": name, **SCANLINE} | ({"view": view} if view else {})
        made.append(OpenEXR.Part(said, random_planes(channels, (4, 6), seed=len(made))))
    OpenEXR.File(made).write(str(path))
    return path


def plain_names(path, view):
    headers = in_view(path, read_headers(path), view)
    return {channel.plain: channel.name for header in headers for channel in header.channels}


def test_views_of_one_part_are_in_the_names_of_its_channels(tmp_path):
    path = write(tmp_path / "a.exr", TWO_VIEWS, multiView=["right", "left"])
    assert views_of(read_headers(path)) == ("right", "left")
    of_no_view = {"disparityL.x": "disparityL.x"}
    left = {name: f"left.{name}" for name in "RGBAZ"} | {"forward.u": "forward.left.u"}
    assert plain_names(path, "left") == left | of_no_view
    right = {name: name for name in "RGBAZ"} | {"forward.u": "forward.right.u"}
    assert plain_names(path, "right") == plain_names(path, None) == right | of_no_view
    assert plain_names(path, "LEFT") == plain_names(path, "left")


def test_views_of_parts_are_their_attribute(tmp_path):
    parts = {
        f"{layer}_{view}": (channels, view)
        for view in ("left", "right")
        for layer, channels in (("rgba", "RGBA"), ("depth", "Z"))
    }
    path = several_parts(tmp_path / "a.exr", parts)
    color = read_color(path, view="right")
    expected = random_planes("RGBA", (4, 6), seed=2)
    np.testing.assert_array_equal(color.planes[0], expected["R"])
    np.testing.assert_array_equal(color.extras["depth.Z"], random_planes("Z", (4, 6), seed=3)["Z"])
    assert set(color.extras) == {"depth.Z"}
    assert color.attributes["view"].value == b"right"  # type: ignore[attr-defined]
    assert "view right" in color.note


def test_without_a_name_the_default_view_is_taken_and_said_to_be(tmp_path):
    parts = {"right": ("RGB", "right"), "left": ("RGB", "left")}
    color = read_color(several_parts(tmp_path / "a.exr", parts))
    np.testing.assert_array_equal(color.planes[0], random_planes("RGB", (4, 6))["R"])
    assert color.warnings == ("view right taken, the default of right, left; ‹view› names another",)


@pytest.mark.parametrize("damage", [b"\xff\xff\xff\x7f", b"\xfe\xff\xff\xff"])
def test_a_damaged_list_of_views_is_an_error(damage, tmp_path):
    path = write(tmp_path / "a.exr", TWO_VIEWS, multiView=["right", "left"])
    data = path.read_bytes()
    path.write_bytes(data.replace(b"\x05\0\0\0right", damage + b"right"))
    with refuses("damaged", path=path):
        read_headers(path)
