"""The command that renders a sample again says all of its lens, with all digits."""

import shlex
from pathlib import Path

from records import taken

from defocus_core.batch.journal.resume import settings
from defocus_core.errors import CALLER
from defocus_core.reports.html.render_command import render_command
from defocus_core.request.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.request.lens import lens_record
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.resolver import Given, lens_of

LENS = {
    "focal-length": "51.2345678901mm",
    "fnumber": "1.8123456789",
    "sensor-width": "35.9123456789mm",
    "focus": "2345.6789012mm",
    "sharp-range": "1801.2345678mm..inf",
    "cat-eye": "1.0512345678:1.5123456789",
    "axial-color": "0.112345678mm:-0.05mm",
    "vignetting": "on",
    "blades": "7",
    "blade-rotation": "15.123456789",
    "spherical": "-0.123456789",
    "highlights": "0.9123456789:20",
    "dp-model": "smooth",
    "noise": "4000.123456789:3",
}


def command(texts, reading, folder):
    """The words of the command of a picture taken by a lens of options."""
    picture = Picture("a", Path("a.exr"), Path("a.exr"))
    lens = lens_of({name: Given(text, CALLER) for name, text in texts.items()})
    job = Job(picture, lens, reading, Outputs(Path()), Machine())
    record = taken(
        folder,
        "a",
        settings=settings(job),
        inputs={role: {"path": "/a.exr"} for role in ("color", "depth")},
        lens=lens_record(job.lens),
    )
    return shlex.split(render_command(record, Path()))


def test_a_command_has_a_blur_in_pixels(tmp_path):
    blur = {"blur": "7.123456789px", "focus-value": "0.2", "clamp-blur": "6px", "blades": "5"}
    words = command(blur, Reading(invert="invert"), tmp_path)
    said = words[words.index("-o") + 2 :]
    assert sorted(said[:-1:2]) == ["--blades", "--blur", "--clamp-blur", "--focus-value"]
    assert said[said.index("--blur") + 1] == "7.123456789px"
    assert said[-1] == "--invert"


def test_a_command_has_every_digit_of_a_lens(tmp_path):
    values = {name: LENS_OPTIONS[name].parse(text) for name, text in LENS.items()}
    reading = Reading(depth_range=(1000.0, 20000.5), fov=40.0, geometry="radial")
    words = command(LENS, reading, tmp_path)
    said = {name: words[words.index(f"--{name}") + 1] for name in LENS}
    assert {name: LENS_OPTIONS[name].parse(text) for name, text in said.items()} == values
    assert words[-6:] == ["--depth-range", "1000mm", "20000.5mm", "--radial", "--fov", "40"]
