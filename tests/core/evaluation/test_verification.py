"""The checks of ``defocus verify`` pass, and each of them fails on a renderer with its fault."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import chain, count

import pytest
import torch
from torch.nn.functional import avg_pool2d

from defocus_core import Views
from defocus_core.evaluation import lens_laws
from defocus_core.evaluation.lens_laws import Check, LawSetting, levels
from defocus_core.renderer.render import render as true_render

Render = Callable[..., Views]
GPU_ALIKE = LawSetting("cpu:0", "standard")  # not "cpu": compared with it as a GPU is


def on_pictures(change):
    """A renderer that does something to each of its pictures."""

    def wrong(image, radius, **options):
        seen = true_render(image, radius, **options)  # type: ignore[arg-type]
        return seen._replace(images=[change(image) for image in seen.images])

    return wrong


def on_radii(change):
    """A renderer that takes radii for others."""
    return lambda image, radius, **options: true_render(image, change(radius), **options)


def on_pair(change):
    def wrong(image, radius, **options):
        seen = true_render(image, radius, **options)  # type: ignore[arg-type]
        if seen.left is None or seen.right is None:
            return seen
        left, right = change(seen.left, seen.right)
        return seen._replace(images=[seen.render, left, right])

    return wrong


def brighter_by(option):
    """A renderer whose pictures depend a little on an option that must not matter."""

    def wrong(image, radius, **options):
        scale = 1 + 1e-6 * float(options[option])  # type: ignore[arg-type]
        return on_pictures(lambda picture: picture * scale)(image, radius, **options)

    return wrong


def brighter_each_time():
    calls = count()
    return on_pictures(lambda picture: picture * (1 + 1e-3 * next(calls)))


def half_precision(picture):
    """With the numbers of half precision, unless it is in double."""
    return picture.half().float() if picture.dtype == torch.float32 else picture


def vignette(picture):
    """Darker to the right and below, as if places in the frame mattered."""
    H, W = picture.shape[-2:]
    down, across = torch.linspace(1, 0.999, H)[:, None], torch.linspace(1, 0.999, W)
    return picture * (down * across).to(picture)


def soft(picture):
    return avg_pool2d(picture, 9, stride=1, padding=4, count_include_pad=False)


FAULTS: dict[str, tuple[Render, set[tuple[str, str]]]] = {
    "blurred too wide": (on_radii(lambda r: 1.03 * r), {("PSF radius", "")}),
    "blurred too wide where it is wide": (
        on_radii(lambda r: r * (1.02 if float(r.detach().max()) > 20 else 1)),
        {("PSF radius", "second-moment")},
    ),
    "a soft lens": (on_pictures(soft), {("sharp rim", ""), ("focus", "")}),
    "moved": (on_pictures(lambda x: x.roll(1, -1)), {("centroid", "")}),
    "halves swapped": (on_pair(lambda left, right: (right, left)), {("half discs", "")}),
    "no halves": (on_pair(lambda a, b: ((a + b) / 2, (a + b) / 2)), {("half discs", "")}),
    "energy lost": (
        on_pictures(lambda x: 0.999 * x),
        {("energy", ""), ("white", ""), ("focus", "")},
    ),
    "one half darker": (on_pair(lambda left, right: (0.999 * left, right)), {("left + right", "")}),
    "farther covers": (on_radii(torch.neg), {("nearer covers", "")}),
    "places matter": (on_pictures(vignette), {("tiles", ""), ("symmetry", "")}),
    "threads matter": (brighter_by("threads"), {("same bytes", "1 and 2")}),
    "outputs matter": (brighter_by("left_right"), {("same bytes", "with and")}),
    "precision matters": (on_pictures(half_precision), {("rounding", "float32")}),
    "last bits matter": (
        on_radii(lambda r: torch.where(r.detach() > levels().amax().to(r), r + 0.1, r)),
        {("rounding", "last bits")},
    ),
    "a wrong slope": (on_radii(lambda r: 2 * r - r.detach()), {("gradient", "")}),
    "machines matter": (brighter_each_time(), {("CPU and GPU", "")}),
    "not a number": (
        on_pictures(lambda x: x * math.nan),
        {(law, "") for law in ("energy", "centroid", "white", "left +", "focus", "nearer", "CPU")},
    ),
}


def rows(found, named):
    law, measured = named
    return [c for c in found if c.law.startswith(law) and c.measured.startswith(measured)]


def all_checks(setting, laws=()):
    return [check for found in lens_laws.verify(setting, laws) for check in found]


def measured_by(renderer, sound, named, device="cpu:0"):
    """The checks of a renderer by the laws that measure the rows named; all would take minutes."""
    laws = zip(lens_laws.LAWS, sound, strict=True)
    wanted = [law for law, passed in laws if any(rows(passed, name) for name in named)]
    return all_checks(LawSetting(device, render=renderer), wanted)


@pytest.fixture(scope="module")
def sound():
    """Of each law."""
    return list(lens_laws.verify(GPU_ALIKE))


def test_the_renderer_passes_at_standard_quality(sound):
    assert [check for check in chain(*sound) if not check.ok] == []


def test_a_point_is_a_sharp_disc_of_its_radius_at_the_highest_quality():
    laws = lens_laws.psf_radius, lens_laws.sharp_rim
    assert all(check.ok for check in all_checks(LawSetting(quality="reference"), laws))


# By all laws; of drafts by those whose frames are large enough to be halved.
PASSES = [
    ("draft", (lens_laws.tiles, lens_laws.same_bytes, lens_laws.devices)),
    *(pytest.param(quality, (), marks=pytest.mark.bench) for quality in ("high", "reference")),
]


@pytest.mark.parametrize(("quality", "laws"), PASSES)
def test_the_renderer_passes(quality, laws):
    found = all_checks(LawSetting(quality=quality), laws)
    assert [check for check in found if not check.ok] == []
    skipped = [check.law for check in found if check.value is None]
    assert skipped == ["CPU and GPU"]


def test_two_devices_are_compared(sound):
    (check,) = rows([*chain(*sound)], ("CPU and GPU", ""))
    assert check.value is not None
    assert check.ok


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_fails_the_rows_of_its_law(fault, sound):
    wrong, named = FAULTS[fault]
    found = measured_by(wrong, sound, named)
    for name in named:
        assert rows(found, name)
        assert not [check for check in rows(found, name) if check.ok]


@pytest.mark.parametrize(
    ("fault", "law"), [("halves swapped", "half discs"), ("one half darker", "left + right")]
)
def test_a_fault_of_the_pair_alone_leaves_the_centre_sound(fault, law, sound):
    centre = {"PSF radius", "sharp rim", "centroid", "energy", "gradient"}
    named = {(name, "") for name in (law, *centre)}
    found = measured_by(FAULTS[fault][0], sound, named, "cpu")
    failed = {check.law for check in found if not check.ok}
    assert law in failed
    assert not failed & centre


def test_every_row_can_fail(sound):
    every = [*chain(*sound)]
    failing = [rows(every, name) for _, named in FAULTS.values() for name in named]
    told = {(check.law, check.measured) for found in failing for check in found}
    assert told == {(check.law, check.measured) for check in every}


def test_a_check_that_is_not_a_number_fails_and_one_without_a_number_does_not():
    check = Check("law", "measured", "px", 1.0, 1.0)
    assert check.ok
    assert replace(check, value=None).ok
    for value in (1.1, math.nan, math.inf):
        assert not replace(check, value=value).ok


@pytest.mark.parametrize("r", [8.0, 20.0])
def test_a_disc_is_measured_as_what_it_is(r):
    """The disc is anti-aliased over one pixel: 0.8 px of a linear fall."""
    at = torch.arange(61, dtype=torch.float64) - 30
    disc = (r + 0.5 - torch.hypot(at, at[:, None])).clamp(0, 1)
    assert lens_laws.rim_width(disc, r) == pytest.approx(0.8, abs=0.1)
    assert lens_laws.disc_radius(disc) == pytest.approx(r, rel=0.01)
    assert lens_laws.centroid(disc.roll((2, -3), (0, 1))) == pytest.approx((-3, 2))
    assert lens_laws.rim_width(torch.ones_like(disc), r) == math.inf
