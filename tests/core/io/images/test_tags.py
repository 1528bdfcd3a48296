"""What a photograph says about its camera and its author is in the pictures made of it."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import HEIGHT, WIDTH, depth_exr, photograph, render, texture
from image_files import save

PHOTOGRAPH = {
    "Make": "Canon",
    "DateTime": "2020:01:02 03:04:05",
    "FNumber": 2.8,
    "Exif__FocalLength": 35.0,
    "Exif__DateTimeOriginal": "2020:01:02 03:04:05",
    "Exif__PhotographicSensitivity": 400,
    "GPS__LatitudeRef": "N",
}
OF_ENCODING = {"Orientation": 3, "Exif__PixelXDimension": 7, "Exif__ColorSpace": 65535}


def tags(path):
    file = oiio.ImageInput.open(str(path))
    return {attribute.name: attribute.value for attribute in file.spec().extra_attribs}


def tagged(folder, suffix):
    samples = (255 * texture(WIDTH, HEIGHT)).astype(np.uint8)
    return save(folder / f"photo{suffix}", samples, **PHOTOGRAPH, **OF_ENCODING)


@pytest.mark.parametrize("kept_by", ["jpg", "png", "tiff"])
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_camera_and_author_are_kept(suffix, kept_by, tmp_path):
    photo, depth = tagged(tmp_path, suffix), depth_exr(tmp_path / "depth.exr")
    known = tags(photo)
    assert known["FNumber"] == pytest.approx(2.8), "OpenImageIO did not write it"
    photograph(photo, depth, "-o", tmp_path / "out", "--format", kept_by)
    (written,) = (tmp_path / "out" / "render").iterdir()
    kept = tags(written)
    for name in PHOTOGRAPH:
        if name == "Exif__PhotographicSensitivity" and "tif" in suffix + kept_by:
            continue  # OpenImageIO writes no whole numbers of EXIF into a TIFF
        of_lens = {"FNumber": 2.0, "Exif__FocalLength": 50.0}
        assert kept[name.replace("__", ":")] == of_lens.get(name, known[name.replace("__", ":")])
    assert kept["Software"] == "defocus"
    assert kept.get("Orientation", 1) == 1, "the pixels are upright, and would be turned again"
    assert kept.get("Exif:PixelXDimension", WIDTH) == WIDTH
    assert kept.get("Exif:ColorSpace", 1) == 1


def test_text_that_is_not_utf_8_is_taken_for_latin_1(tmp_path):
    samples = (255 * texture(WIDTH, HEIGHT)).astype(np.uint8)
    photo = save(tmp_path / "photo.jpg", samples, Artist="J?rgen")
    photo.write_bytes(photo.read_bytes().replace(b"J?rgen", b"J\xfcrgen"))
    args = (photo, depth_exr(tmp_path / "depth.exr"), "-o", tmp_path / "out")
    photograph(*args, "--format", "jpg")
    assert tags(tmp_path / "out" / "render" / "photo.jpg")["Artist"] == "J\xfcrgen"


def test_tags_that_are_too_long_for_a_jpeg_are_left_out(tmp_path):
    """libjpeg ends the process if they are more than 64 KB."""
    groups = ("Exif__LensModel", "Exif__UserComment", "Exif__LensMake", "Exif__BodySerialNumber")
    long = dict.fromkeys((*groups, "ImageDescription", "Artist", "Copyright"), "é" * 10000)
    samples = (255 * texture(WIDTH, HEIGHT)).astype(np.uint8)
    photo = save(tmp_path / "photo.png", samples, Make="camera", **long)
    args = (photo, depth_exr(tmp_path / "depth.exr"), "-o", tmp_path / "out")
    photograph(*args, "--format", "jpg")
    kept = tags(tmp_path / "out" / "render" / "photo.jpg")
    assert kept["Make"] == "camera"
    assert "Artist" not in kept


def test_exr_takes_no_tags_of_a_photograph(tmp_path):
    photo, depth = tagged(tmp_path, ".jpg"), depth_exr(tmp_path / "depth.exr")
    assert render(photo, depth, "-o", tmp_path / "out").code == 0
    assert "FNumber" not in tags(tmp_path / "out" / "render" / "photo.exr")
