"""Files of several images: a TIFF has pages, of which one is meant."""

import os
import resource
from contextlib import suppress
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import WIDTH, ramp, run, texture
from image_files import from_srgb, save
from refusals import refuses

from defocus_core import InputError, read_color
from defocus_core.io.images.describe import describe

THUMBNAIL = 1


def tiff(path, *pages, kinds=None):
    """A TIFF of some pages; ``kinds`` has the NewSubfileType of those that have one."""
    specs = [
        oiio.ImageSpec(page.shape[1], page.shape[0], page.shape[2], str(page.dtype))
        for page in pages
    ]
    for number, kind in (kinds or {}).items():
        specs[number].attribute("tiff:subfiletype", kind)
    output: Any = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), tuple(specs))
    for number, page in enumerate(pages):
        assert number == 0 or output.open(str(path), specs[number], "AppendSubimage")
        assert output.write_image(page)
    assert output.close()
    return path


def photograph(seed):
    return (texture(seed=seed) * 255).astype(np.uint8)


def test_of_several_pages_one_is_chosen_by_number(tmp_path):
    pages = [photograph(seed) for seed in range(3)]
    path = tiff(tmp_path / "a.tif", *pages)
    with refuses("ambiguous", "3 pages", "‹part›", path=path):
        read_color(path)
    for number, page in enumerate(pages):
        expected = from_srgb(page / 255)
        np.testing.assert_allclose(read_color(path, part=number).pixels, expected, rtol=1e-6)
    with refuses("no-such-part", "0 to 2", path=path):
        read_color(path, part=3)


def test_a_thumbnail_is_no_page_to_choose_from(tmp_path):
    small, large = photograph(1)[::2, ::2], photograph(0)
    path = tiff(tmp_path / "a.tif", small, large, kinds={0: THUMBNAIL})
    assert read_color(path).shape == large.shape
    assert describe(path).width == WIDTH
    assert read_color(path, part=0).shape == small.shape


def test_a_page_may_be_the_depth(tmp_path):
    millimetres = (ramp() * 1000).astype(np.uint16)[..., None]
    path = tiff(tmp_path / "z.tif", np.zeros_like(millimetres), millimetres)
    told = run("info", path, "--part", "1", "--json").json["files"][0]
    assert told["depth"]["range_m"] == [1.0, 4.0]


@pytest.mark.parametrize("kind", ["png", "jpg", "tif"])
def test_too_few_descriptors_are_no_fault_of_a_picture(kind, tmp_path):
    paths = [save(tmp_path / f"{number}.{kind}", photograph(0)) for number in range(4)]
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, limit[1]))
    taken: list[int] = []
    try:
        with suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        for path in paths:
            with pytest.raises(InputError, match="ulimit -n"):
                read_color(path)
            os.close(taken.pop())
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, limit)
