"""The command that renders a picture says all of its lens, with all digits."""

from pathlib import Path

from jobs_files import option

from defocus_core.batch.journal.resume import settings
from defocus_core.reports.html.focus_choice import render_words
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading
from defocus_core.request.lens import lens_record
from defocus_core.request.parameters import EFFECT_OPTIONS, LENS_OPTIONS
from defocus_core.request.resolver import lens_of

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


def command(texts, reading):
    """The words of the command of a picture taken by a lens of options."""
    picture = PictureFiles("a", Path("a.exr"), Path("a.exr"))
    lens = lens_of({name: option(name, text) for name, text in texts.items()})
    job = Job(picture, lens, reading, Outputs(Path()), Machine())
    asked = settings(job)
    exact = {key: value for key, value in asked["lens"].items() if key in EFFECT_OPTIONS}
    return list(map(str, render_words(picture, "again", lens_record(job.lens) | exact, asked)))


def test_a_command_has_a_blur_in_pixels():
    blur = {"blur": "7.123456789px", "focus-value": "0.2", "clamp-blur": "6px", "blades": "5"}
    words = command(blur, Reading(invert=True))
    said = words[words.index("-o") + 2 :]
    assert sorted(said[:-1:2]) == ["--blades", "--blur", "--clamp-blur", "--focus-value"]
    assert said[said.index("--blur") + 1] == "7.123456789px"
    assert said[-1] == "--invert"


def test_a_command_has_every_digit_of_a_lens():
    values = {name: LENS_OPTIONS[name].parse(text) for name, text in LENS.items()}
    reading = Reading(depth_range=(1000.0, 20000.5), fov=40.0, geometry="radial")
    words = command(LENS, reading)
    said = {name: words[words.index(f"--{name}") + 1] for name in LENS}
    assert {name: LENS_OPTIONS[name].parse(text) for name, text in said.items()} == values
    assert words[-6:] == ["--depth-range", "1000mm", "20000.5mm", "--radial", "--fov", "40"]
