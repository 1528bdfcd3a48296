"""Every option at both of its ends leaves pictures and gradients finite, and none too bright."""

from typing import Any

import pytest
import torch
from extremes import DTYPES, KINDS, MAX_RADIUS, Extreme, dots
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from measures import worst
from renderers import QUALITIES

from defocus_core import Aperture, render

MIRROR = {"obstruction": 0.4}
GAUSSIAN, REFERENCE = {"psf_type": "gaussian"}, {"quality": "reference"}
INWARD, OUTWARD = GAUSSIAN | {"spherical": -1.0}, GAUSSIAN | {"spherical": 1.0}
RING = INWARD | {"obstruction": 0.95, "squeeze": 20.0}
TALL = GAUSSIAN | {"spherical": 0.7, "squeeze": 0.05}
FLAT = GAUSSIAN | {"blades": 3, "curvature": 0.0, "squeeze": 0.6}
WHOLE, PAIR = {"size": 1.0, "vignetting": True}, {"model": "smooth"}
HALF, BRAIN = torch.float16, torch.bfloat16
CASES = [
    # an opaque disc that hides the frame, in part or all of it
    *(
        Extreme((48, 64), r, pupil=MIRROR, options={"quality": q})
        for r in (100.0, 200.0, 278.0, MAX_RADIUS)
        for q in ("standard", "reference")
    ),
    # light that is 0 at the only sample of a small disc
    *(
        Extreme(radius=r, pupil={"spherical": k}, learnt="spherical")
        for r in (0.15, 0.3, 0.5)
        for k in (-1.0, 1.0)
    ),
    # parts of the pupil that see nothing of the frame
    *(Extreme(radius=r, pupil=GAUSSIAN, options=REFERENCE) for r in (400.0, 5000.0)),
    # numbers of the pupil where they begin
    Extreme(pupil={"obstruction": 0.0}, learnt="obstruction"),
    Extreme(pupil={"blades": 5, "curvature": 0.0}, learnt="curvature"),
    Extreme((5, 5), rim={"size": 1.0, "shift": 0.0, "vignetting": True}, learnt="shift"),
    Extreme((5, 5), rim={"size": 1.0, "shift": 0.4, "vignetting": True}, learnt="size"),
    Extreme((1, 1), pupil={"squeeze": 2.0}, learnt="squeeze"),
    # both ends of others, in small and narrow frames
    Extreme((1, 1), MAX_RADIUS, pupil={"obstruction": 0.95}, dtype=torch.float64),
    Extreme((1, 24), 30.0, "checkerboard", pupil={"squeeze": 0.05}, learnt="squeeze"),
    Extreme((24, 1), 30.0, "checkerboard", pupil={"squeeze": 20.0}, learnt="squeeze"),
    Extreme((3, 8191), 3.0),
    Extreme(radius=30.0, pupil={"image": dots()}),
    Extreme(radius=300.0, rim={"size": 0.1, "shift": 0.09}),
    # a light next to focus that is drawn as a disc, beside one that is not
    Extreme((9, 1), 0.3, "constant", -1, 1.0, 3, HALF, 21891, INWARD, options=REFERENCE),
    Extreme((1, 9), 0.3, "constant", -1, 1e-3, 3, torch.float64, 20492, OUTWARD, WHOLE, PAIR),
    # halves of unequal shares that learn
    Extreme((1, 1), 60.0, pupil=FLAT, learnt="squeeze"),
    # a ring 0.4 px wide, of which hardly any part sees the frame: the disc of a light is divided by
    # this share, which is summed up in another way, and was 1.55 times the light
    Extreme((2, 3), 4.0, "checkerboard", 0, seed=22373, pupil=RING, pair=PAIR, learnt="spherical"),
    # hidden surfaces of two slices, whose radii learn
    Extreme((2, 3), 15.0, "random", -1, dtype=BRAIN, seed=11764, pupil=TALL),
    Extreme(light=1e30, kind="random", side=0),
    Extreme(light=0.0, kind="random", side=0),
    Extreme(light=65504.0, kind="random", side=0, dtype=HALF),
]


def named(case):
    pupil = "-".join(case.pupil or case.rim)
    return f"{case.size}-{case.radius:g}-{pupil}-{case.options.get('quality')}"


@pytest.mark.parametrize("case", CASES, ids=named)
def test_pictures_and_gradients_are_finite_at_the_ends(case):
    assert case.faults() == []


@st.composite
def extremes(draw):
    """Any option at any place of its range, pixels times radius bounded."""
    pick = lambda *values: draw(st.sampled_from(values))  # noqa: E731
    return drawn(pick, draw(st.integers(0, 10_000)))


def drawn(pick, seed):
    """An extreme whose options `pick` chooses from lists."""
    quality = pick(*QUALITIES, "standard")
    radius = pick(0.0, 0.15, 0.3, 0.5, 0.9, 4.0, 15.0, 60.0, 278.0, MAX_RADIUS)
    rim = pick(
        {}, {}, {}, {}, {"size": 1.0}, {"size": 0.3, "shift": 0.27}, {"size": 5.0, "shift": 4.5}
    )
    # each slice between the least radius and the greatest takes its time
    few = quality in ("high", "reference") or radius > 15 or rim
    size = pick((1, 1), (2, 3), (1, 9), (9, 1), *([] if few else [(5, 7), (2, 40)]))
    kind = "constant" if few else pick(*KINDS)
    blades = pick(0, 0, 0, 3)
    open_to = 0.5 if blades else 1.0, rim.get("size", 1.0)
    pupil: dict[str, Any] = {
        "blades": blades,
        "psf_type": pick("pillbox", "gaussian"),
        "obstruction": pick(
            *(0.0, 0.0, 1e-9),
            *(obstruction for obstruction in (0.4, 0.95) if obstruction < min(open_to)),
        ),
        "spherical": pick(0.0, -1.0, -0.5, 0.7, 1.0),
        "squeeze": pick(1.0, 1.0, 0.05, 0.6, 2.0, 20.0),
    }
    if blades:
        pupil |= {"rotation": pick(0.0, 90.0, 17.0), "curvature": pick(0.0, 0.0, 5e-4, 0.6, 1.0)}
    if rim:
        rim = rim | {"vignetting": pick(True, False)}
    learnt = [*[""] * 32, "obstruction", "spherical", "squeeze", *(["size"] if rim else [])]
    return Extreme(
        size,
        radius,
        kind,
        pick(-1, 0, 1),
        pick(0.0, 1.0, 1e-3, 1e4, 1e30),
        pick(0, 1, 3),
        pick(*DTYPES),
        seed,
        pupil,
        rim,
        pick({}, {"model": "smooth"}, {"crosstalk": 0.4999}),
        pick(*learnt),
        {"quality": quality, "depth_repair": pick("auto", "off")},
    )


@settings(deadline=None, derandomize=True, max_examples=40, phases=[Phase.generate])
@given(case=extremes())
def test_pictures_and_gradients_are_finite_whatever_is_drawn(case):
    assert case.faults() == []


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("r", [0.3, -0.45, 0.6])
def test_a_light_next_to_focus_is_blurred_like_the_pixels_beside_it(r, quality):
    """Its disc is drawn alone: were it a point, theirs would come on top of it."""
    image = torch.full((1, 40, 40), 0.4999)
    image[0, 17:20, 21:24] = 1.0
    assert float(render(image, torch.full((40, 40), r), quality=quality).render.max()) < 1.001


@pytest.mark.parametrize("quality", ["standard", "reference"])
@pytest.mark.parametrize("radius", [90.0, 120.0, 150.0])
def test_what_an_opaque_disc_nearly_hides_is_not_rounding(quality, radius):
    """The share of the pupil that sees the frame there is hardly more than rounding errors."""
    image, far = Extreme((48, 64), dtype=torch.float64, lights=0).scene()
    far = torch.full_like(far, radius)
    pupil = Aperture(**MIRROR)
    options = {"aperture": pupil, "quality": quality, "left_right": True}
    wide, narrow = render(image, far, **options), render(image.float(), far.float(), **options)
    for one, other in zip(wide.images, narrow.images, strict=True):
        assert worst(one, other.double()) < 1e-4


@pytest.mark.parametrize("pupil", [GAUSSIAN, {"spherical": 0.9}], ids=str)
def test_what_falls_into_the_frame_of_a_wide_disc_is_its_share(pupil):
    """The kernel is the middle of the whole one, not that divided by its sum."""
    radius = torch.tensor(40.0, dtype=torch.float64)
    whole, cut = (Aperture(**pupil).kernel(radius, n) for n in (83, 31))
    assert worst(cut, whole[26:-26, 26:-26]) < 2e-3 * float(whole.max())


def test_a_rim_that_an_opaque_middle_fills_is_refused():
    """No light passes both: light divided by none of it was 3 to 48 times the brightest pixel."""
    rim, ring = {"size": 0.3, "shift": 0.27}, {"obstruction": 0.4}
    with pytest.raises(ValueError, match="cat_eye must be larger than the opaque middle"):
        Extreme((2, 3), pupil=ring, rim=rim).faults()
    assert Extreme((2, 3), pupil=ring, rim={**rim, "size": 0.45}).faults() == []
