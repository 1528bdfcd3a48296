"""Lens files that ship: each is a lens with a look, by its name."""

import numpy as np
import pytest
from command_line import header, pair, refused, run, succeed
from image_files import samples_of
from jobs_files import option

from defocus_core.allowed_values import DUAL_PIXEL_SENSORS
from defocus_core.request.lens_files import shipped_lenses
from defocus_core.request.picture_lenses import PictureLenses

LENSES = shipped_lenses()


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.name)
def test_a_lens_that_ships_wants_a_focus_alone(lens):
    made = PictureLenses({"focus": option("focus", "20m")}, file=lens.path).fixed
    assert made.foclen > 0
    assert made.effects or made.blades
    assert 10 < len(lens.subject) < 80


def test_lenses_lists_them():
    ran = succeed("lenses")
    names, _, sensors = ran.out.partition("\n\n")
    assert [line.split()[0] for line in names.splitlines()] == [lens.name for lens in LENSES]
    assert [line.split()[1] for line in sensors.splitlines()] == list(DUAL_PIXEL_SENSORS)
    told = run("lenses", "--json").json
    assert told["lenses"][0]["name"] == LENSES[0].name
    assert {row["name"] for row in told["sensors"]} == DUAL_PIXEL_SENSORS.keys()
    assert len(LENSES) >= 6


def test_a_lens_is_taken_by_its_name_and_options_beside_it_win(tmp_path):
    color, depth = pair(tmp_path)
    options = ("-o", tmp_path / "out", "--focus", "2m", "--fnumber", "2")
    succeed("render", color, depth, *options, "--lens", "@portrait-85")
    attributes = header(tmp_path / "out/render/a.exr")
    assert attributes["defocus:focal_length"] == "85mm"
    assert attributes["defocus:fnumber"] == "2"
    assert attributes["defocus:blades"] == "9"


def test_a_contact_sheet_shows_another_look_of_each(tmp_path):
    sheet = tmp_path / "sheet.png"
    succeed("lenses", "-o", sheet)
    pixels = samples_of(sheet)
    assert pixels.shape[:2] == (226 * -(-len(LENSES) // 3), 900)
    tiles = [pixels[226 * (i // 3) :, 300 * (i % 3) :][:200, :300] for i in range(len(LENSES))]
    flat = [tile.astype(float).ravel() for tile in tiles]
    assert all(np.abs(a - b).max() > 15 for i, a in enumerate(flat) for b in flat[:i])
    refused(run("lenses", "-o", sheet), 3, "exists", sheet)
    refused(run("lenses", "-o", tmp_path / "sheet.jpg"), 3, "malformed", "sheet.jpg")
