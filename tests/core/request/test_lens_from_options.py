"""A lens file is the lens options under their names; options on the command line win."""

import math

import pytest
from refusals import refuses, refuses_as

from defocus_core.request.lens import Lens
from defocus_core.request.lens_from_options import make_lens

FLAGS = {"focal-length": 50.0, "fnumber": 2.0, "focus": 2000.0}
OTHER_WAYS = 'focal-length = "50mm"\naperture-diameter = "25mm"\nfocus-at = [3, 4]\n'
TURNED = "blade-rotation = 30\n"


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
            Lens(50.0, 2.0, 2000.0, blades=6, blade_rotation=15.0),
        ),
        ("", {"focal-length": 50.0, "aperture-diameter": 25.0, "focus": 2e3}, Lens(50.0, 2.0, 2e3)),
        ('\ufefffocal-length = "50mm"\n', {"fnumber": 2.0, "focus": 2e3}, Lens(50.0, 2.0, 2e3)),
        (
            'focal-length = "85mm"\nfnumber = 4\nfocus = inf\n',
            {"fnumber": 2.0},
            Lens(85.0, 2.0, math.inf),
        ),
        (OTHER_WAYS, {}, Lens(50.0, 2.0, None, focus_at=(3, 4))),
        (OTHER_WAYS, {"fnumber": 8.0, "focus": 1e3}, Lens(50.0, 8.0, 1e3)),
        (TURNED, {**FLAGS, "blades": 5}, Lens(50.0, 2.0, 2e3, blades=5, blade_rotation=30.0)),
        (f"blades = 6\n{TURNED}", {**FLAGS, "blades": 0}, Lens(50.0, 2.0, 2e3)),
    ],
)
def test_flags_win_over_a_file_and_over_the_other_way_to_say_it(text, flags, lens, tmp_path):
    assert make_lens(flags, lens_file(tmp_path, text)) == lens


@pytest.mark.parametrize(
    ("text", "change", "refusal"),
    [
        *(("", {name: None}, f"missing-option {name}") for name in FLAGS),
        ("", {"aperture-diameter": 25.0}, "contradiction fnumber"),
        ("", {"focus-at": (1, 1)}, "contradiction focus"),
        ('fnumber = 2\naperture-diameter = "25mm"\n', {"fnumber": None}, "contradiction fnumber"),
        ("", {"focus": 49.0}, "out-of-range focus"),
        ("", {"focus": 50.0}, "out-of-range focus"),
        ("", {"blade-rotation": 30.0}, "idle-option blade-rotation"),
        ("", {"blades": 0, "blade-rotation": 30.0}, "idle-option blade-rotation"),
        (TURNED, {}, "idle-option blade-rotation"),
        (f"blades = 0\n{TURNED}", {}, "idle-option blade-rotation"),
        ("[lens]", {}, "unknown-name"),
        ("iso = 100", {}, "unknown-name"),
        ("focal-length = 50", {}, "malformed focal-length"),
        ("focus-at = [1, 2, 3]", {}, "malformed focus-at"),
        ("blades = 2", {}, "malformed blades"),
        ("blades = true", {}, "malformed blades"),
        ("fnumber = 2\nfocus 2m\n", {}, "malformed"),
    ],
)
def test_what_makes_no_lens_is_refused_with_its_option(text, change, refusal, tmp_path):
    with refuses_as(refusal):
        make_lens({**FLAGS, **change}, lens_file(tmp_path, text))


def test_a_file_that_is_not_there_is_input(tmp_path):
    for path, code in ((tmp_path / "no.toml", "not-found"), (tmp_path, "unreadable")):
        with refuses(code, path=path):
            make_lens(FLAGS, path)
