"""Options stand in layers, of which the later win, and are checked once all are known."""

import math
from pathlib import Path

import pytest
from elements import disc, element, write
from jobs_files import PictureFiles, Reading, lens_values, option
from refusals import refuses

from defocus_core.errors import Place
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import (
    ROWS,
    laid_over,
    layer_of,
    reading_of,
    refuse_contradiction,
)

FLAGS = {"focal-length": "50mm", "fnumber": "2", "focus": "2m"}
OTHER_WAYS = 'focal-length = "50mm"\nfnumber = 2\nfocus-at = [3, 4]\n'
TURNED = "blade-rotation = 30\n"


def lens_of(flags, file):
    own = {name: option(name, text) for name, text in flags.items() if text is not None}
    refuse_contradiction(own)
    return PictureLenses(own, file=file).fixed


def lens_file(folder, text):
    path = folder / "lens.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "flags", "lens"),
    [
        (
            'focal-length = "5cm"\nfnumber = 2\nfocus = "2m"\nblades = 6\nblade-rotation = 15\n',
            {},
            lens_values(50.0, 2.0, 2000.0, blades=6, blade_rotation=15.0),
        ),
        (
            '\ufefffocal-length = "50mm"\n',
            {"fnumber": "2", "focus": "2m"},
            lens_values(50.0, 2.0, 2e3),
        ),
        (
            'focal-length = "85mm"\nfnumber = 4\nfocus = inf\n',
            {"fnumber": "2"},
            lens_values(85.0, 2.0, math.inf),
        ),
        (OTHER_WAYS, {}, lens_values(50.0, 2.0, None, focus_at=(3, 4))),
        (OTHER_WAYS, {"fnumber": "8", "focus": "1m"}, lens_values(50.0, 8.0, 1e3)),
        (
            TURNED,
            {**FLAGS, "blades": "5"},
            lens_values(50.0, 2.0, 2e3, blades=5, blade_rotation=30.0),
        ),
        (f"blades = 6\n{TURNED}", {**FLAGS, "blades": "0"}, lens_values(50.0, 2.0, 2e3)),
    ],
)
def test_flags_win_over_a_file_and_over_the_other_way_to_say_it(text, flags, lens, tmp_path):
    assert lens_of(flags, lens_file(tmp_path, text)) == lens


def layer(**values):
    rows = {name.replace("_", "-"): value for name, value in values.items()}
    return layer_of(rows, ROWS, Place(Path("folder/list.csv"), "line 3").with_field)


def test_later_layers_win_and_take_the_alternatives_along():
    below = layer(focus="2m", blades=6, blade_rotation=10)
    above = layer(focus_at=[1, 2], blades=0)
    assert laid_over(below, above) == above
    assert reading_of(layer(radial=True), layer(planar=True)).geometry == "planar"
    with refuses("contradiction", field="radial"):
        layer(radial=True, planar=True)


def test_paths_are_relative_to_the_file_they_stand_in():
    assert layer(aperture_image="pupil.png")["aperture-image"].text == "folder/pupil.png"


def test_metadata_win_over_a_lens_file_and_all_else_over_metadata(tmp_path):
    path = write(tmp_path / "a.exr", element(disc()), focus=3.0, aperture=4.0)
    file = lens_file(tmp_path, 'focal-length = "50mm"\nfnumber = 2\nfocus = "9m"\n')
    picture = PictureFiles("a", path, path)
    lenses = PictureLenses(layer(fnumber=8), file=file, metadata=True)
    lens, taken = lenses.lens_of(picture)
    assert (lens.foclen, lens.fnum, lens.foc_dist, [*taken]) == (50, 8, 3000, ["focus"])
    ((_, own),) = lenses.lenses(picture, [0], layer(focus="5m"))
    assert own.foc_dist == 5000


def test_what_a_lens_file_says_in_vain_beside_radii_is_said(tmp_path, caplog):
    file = lens_file(tmp_path, 'focal-length = "50mm"\nfnumber = 2\nblades = 6\n')
    lens = PictureLenses({}, file=file, reading=Reading(depth_format="coc")).fixed
    assert (lens.is_shape, lens.blades) == (True, 6)
    assert "focal-length, fnumber left out" in caplog.text
