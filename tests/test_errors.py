"""Errors are data, with a code of a table; what Python refuses, it refuses by name: a table."""

import ast
import math
import pickle
import re
from pathlib import Path

import pytest
import torch
from command_line import topic
from renderers import renderer_of

from defocus_core import (
    Aperture,
    CatEye,
    DefocusError,
    DefocusLens,
    Distribution,
    DualPixel,
    HiddenLayer,
    InputError,
    PupilImage,
    RandomDefocus,
    fit,
    guided_depth,
    render,
    render_layers,
    sensitivities,
    with_lights,
    with_noise,
)
from defocus_core.errors import CALLER, CODES, NoteKinds, Place, with_dashes
from defocus_core.optics.distributions import ATTEMPTS
from defocus_core.optics.parts import Part

ROOT = Path(__file__).parents[1]
SOURCES = sorted(ROOT.glob("defocus_c*/**/*.py"))


def raised(path):
    """Codes of the errors that a module makes, where they are literal."""
    calls = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
    return {
        call.args[0].value
        for call in calls
        if isinstance(call.func, ast.Name)
        and call.func.id in ERRORS
        and call.args
        and isinstance(call.args[0], ast.Constant)
    }


def kinds(kind):
    return {kind.__name__}.union(*(kinds(each) for each in kind.__subclasses__()))


ERRORS = kinds(DefocusError) | {"NoDepthChannel"}


def test_each_error_has_a_code_of_the_table_and_each_is_in_use():
    assert set().union(*map(raised, SOURCES)) == CODES.keys()


def test_the_help_has_the_table():
    told = topic("exit-codes")
    for code, meaning in CODES.items():
        assert f"| `{code}` | {meaning} |" in told


def test_an_error_comes_home_from_a_worker_as_it_was():
    error = InputError("damaged", "is damaged", "copy it again", path="a.exr", field="view")
    home = pickle.loads(pickle.dumps(error))
    assert (str(home), vars(home)) == (str(error), vars(error))


def test_options_are_named_in_quotes_and_on_the_command_line_with_dashes():
    error = DefocusError("idle-option", "is idle", "leave ‹blade-rotation› out", field="focus")
    assert (error.field, error.path) == ("focus", None)
    line = "--focus: is idle; leave --blade-rotation out"
    assert with_dashes(str(error)) == line


@pytest.mark.parametrize(
    ("place", "path", "field", "text"),
    [
        (CALLER.with_field("focus"), None, "focus", "‹focus›"),
        (Place("a.toml", "[lens]", "focus"), "a.toml", "focus", "a.toml: [lens] focus"),
        (Place("a.csv", "line 3", "focus"), "a.csv", "focus", "a.csv: line 3: focus"),
        (Place("a.csv", "line 3"), "a.csv", "line 3", "a.csv: line 3"),
        (Place("a.toml", field="focus"), "a.toml", "focus", "a.toml: focus"),
    ],
)
def test_an_error_has_file_and_key_of_its_place(place, path, field, text):
    error = DefocusError("malformed", "is wrong", path=place)
    assert (error.path, error.field, str(error)) == (path, field, f"{text}: is wrong")


def test_notes_of_one_kind_differ_in_file_numbers_and_units_and_one_is_shown():
    notes = [
        "nothing is in focus at 500mm: 3.2 px",
        "nothing is in focus at 2m: 1 px",
        "b.exr: 1 pixel lost",
        "a.exr: 20 pixels lost",
        "nothing is in focus at 1.5m: 7 px",
    ]
    wanted = {"nothing is in focus at 1.5m: 7 px": 3, "a.exr: 20 pixels lost": 2}
    for order in (notes, notes[::-1]):
        kinds = NoteKinds()
        for note in order:
            kinds.add(note)
        assert kinds.counts == wanted


def test_a_message_quotes_at_most_200_characters_of_a_path():
    path = f"/{'a' * 5000}/end.exr"
    error = InputError("not-found", f"is not {path}", f"name {path}", path=path)
    assert max(map(len, str(error).split())) <= 201
    assert str(error).count("end.exr") == 3
    assert error.path == path


SIZE = (24, 32)
IMAGE, RADIUS = torch.rand(3, *SIZE), torch.linspace(-4, 6, SIZE[1]).repeat(SIZE[0], 1)
DEPTH, COVERAGE = torch.rand(SIZE) + 1, torch.ones(2, *SIZE)
LAYERS, RADII = torch.stack([IMAGE, IMAGE]), torch.stack([RADIUS, RADIUS])
DEPTHS = torch.linspace(1e3, 4e3, SIZE[1]).expand(1, *SIZE)
HIDDEN = HiddenLayer(IMAGE, RADIUS + 9, RADIUS < 0)
# Kernels of photodiodes that see the left and the right half, and one over the frame.
LEFT = torch.ones(15, 15).triu()
RIGHT = LEFT.flip(1)
LEFT, RIGHT = RIGHT + 0.1, LEFT + 0.1
KERNEL = torch.tensor(1.0, dtype=torch.float64)


def lens(foclen=50.0, fnum=1.4, **options):
    return DefocusLens(foclen, fnum, (36.0, 27.0), SIZE[::-1], **{"device": "cpu", **options})


def drawn(image=IMAGE[None], depth=DEPTHS, seeds=(1,), **ranges):
    return RandomDefocus(**ranges)(image, depth, seeds)


def tiled(image=IMAGE, radius=RADIUS, hidden=None, **options):
    return list(renderer_of(image, radius, hidden=hidden, **options).tiles())


def of(given, door, *rows):
    """Rows of words, and what is given otherwise to a door that takes the rest."""
    return [(words, lambda change=change: door(**given | change)) for words, change in rows]


ROWS = [
    *of(
        {"image": IMAGE, "signed_radius": RADIUS},
        render,
        ("image must be", {"image": IMAGE[0]}),
        ("decode integers to linear light", {"image": (255 * IMAGE).to(torch.uint8)}),
        ("torch.from_numpy makes a tensor", {"image": IMAGE.numpy()}),
        ("one image is image.None, None", {"image": IMAGE[0]}),
        ("several batches are image.flatten", {"image": IMAGE[None, None]}),
        (r"image.movedim\(-1, -3\)", {"image": IMAGE.movedim(0, -1)}),
        (r"come last, signed_radius\[..., 0\]", {"signed_radius": RADIUS[..., None]}),
        ("resample it to .* by nearest", {"signed_radius": RADIUS[:-1]}),
        ("give one map for each of 2 pictures", {"image": LAYERS}),
        ("infinity must be one radius, or one for each of 1", {"infinity": [1.0, 2.0]}),
        ("image must hold a pixel", {"image": IMAGE[:, :0], "signed_radius": RADIUS[:0]}),
        ("image must be finite", {"image": IMAGE / 0.0}),
        ("image must be within ±1e", {"image": IMAGE * 3e38}),
        ("image must be within ±1e", {"image": -IMAGE * 3e38}),
        ("signed_radius must be", {"signed_radius": RADIUS.T}),
        ("signed_radius must be", {"signed_radius": RADIUS[None, None, None]}),
        ("signed_radius must be", {"image": LAYERS}),
        ("signed_radius must be finite", {"signed_radius": RADIUS * math.nan}),
        ("signed_radius must be finite", {"signed_radius": RADIUS / 0.0}),
        ("quality must be one of standard", {"quality": "best"}),
        ("num_layers must be at least 1", {"num_layers": 0}),
        ("psf_ks must be at least 1", {"psf_ks": 0}),
        ("threads must be at least 1", {"threads": 0}),
        ("one number in px for each of 3 channels", {"color_offsets": (1.0,)}),
        ("cat_eye must be a CatEye", {"cat_eye": 1.0}),
        ("depth_repair must be one of auto, off, got 'on'", {"depth_repair": "on"}),
        ("hidden must be color", {"hidden": HIDDEN._replace(signed_radius=torch.zeros(3, 3))}),
        ("hidden.color must be finite", {"hidden": HIDDEN._replace(color=IMAGE * math.nan)}),
        (
            "hidden.signed_radius must be finite",
            {"hidden": HIDDEN._replace(signed_radius=RADIUS * math.inf)},
        ),
    ),
    *of(
        {"colors": LAYERS, "signed_radius": RADII, "coverage": COVERAGE},
        render_layers,
        ("coverage must be in", {"coverage": COVERAGE + 0.5}),
        ("signed_radius must be finite", {"signed_radius": RADII * math.nan}),
        ("layers must be", {"colors": IMAGE}),
        ("layers must be", {"signed_radius": RADII[:1]}),
        ("colors must be a tensor of floats", {"colors": LAYERS.byte()}),
        ("must be finite", {"colors": LAYERS * math.nan}),
    ),
    *of(
        {},
        Aperture,
        ("blades must be 0 or at least 3, got 2", {"blades": 2}),
        ("got -1", {"blades": -1}),
        ("rotation must be a finite angle", {"rotation": math.nan}),
        ("pillbox, gaussian, got 'airy'", {"psf_type": "airy"}),
        ("curvature must be 0 without blades", {"curvature": 0.5}),
        ("curvature must be from 0 to 1", {"blades": 6, "curvature": 1.5}),
        ("obstruction must be from 0 to 0.95", {"obstruction": 1.0}),
        ("obstruction must be below 0.5, .*got 0.6", {"blades": 3, "obstruction": 0.6}),
        ("spherical must be from -1 to 1", {"spherical": -2.0}),
        ("squeeze must be from 0.05 to 40", {"squeeze": 0.0}),
        ("image must be a PupilImage", {"image": LEFT}),
        ("blades must be 0 beside an image", {"image": PupilImage(LEFT), "blades": 6}),
    ),
    ("size must be at least 1", lambda: Aperture().kernel(KERNEL, 0)),
    ("floating-point", lambda: Aperture().kernel(torch.tensor(3), 7)),
    ("overlap the pupil", lambda: Aperture().kernel(KERNEL, 7, Part(x0=0.9, y0=0.9))),
    ("1, 2, 4 or 16, got 3", lambda: Aperture().parts(3)),
    ("black", lambda: PupilImage(torch.zeros(4, 4))),
    (r"\[H, W\]", lambda: PupilImage(torch.ones(3, 4, 4))),
    ("0 or more", lambda: PupilImage(torch.full((4, 4), -1.0))),
    ("finite", lambda: PupilImage(torch.full((4, 4), math.nan))),
    *(("shift must be", lambda o=o: CatEye(*o)) for o in ((1.0, 0.95), (0.0, 0.0), (1.0, -0.1))),
    ("model must be", lambda: DualPixel(model="round")),
    ("below 0.5", lambda: DualPixel(crosstalk=0.5)),
    ("measured must be two", lambda: DualPixel(measured=(LEFT, RIGHT))),
    ("left must lie left", lambda: sensitivities(RIGHT, LEFT)),
    ("right must be a tensor", lambda: sensitivities(LEFT, RIGHT[1:])),
    ("black", lambda: sensitivities(0 * LEFT, 0 * RIGHT)),
    ("0 or more", lambda: sensitivities(LEFT - 0.2, RIGHT)),
    *of(
        {"electrons": 10, "read": 1, "seed": 1},
        lambda **options: with_noise(IMAGE, **options),
        *((name, {name: wrong}) for name, wrong in (("electrons", 0), ("read", -1), ("seed", -1))),
    ),
    ("threshold must be", lambda: with_lights(IMAGE, 1.0, 2.0)),
    ("gain must be", lambda: with_lights(IMAGE, 0.8, 0.5)),
    ("same size", lambda: fit(IMAGE, DEPTH[:-1], IMAGE)),
    ("shape of sharp", lambda: fit(IMAGE, DEPTH, IMAGE[:, :-1])),
    ("finite", lambda: fit(IMAGE, DEPTH * math.inf, IMAGE)),
    ("differ somewhere", lambda: fit(IMAGE, COVERAGE[0], IMAGE)),
    *(
        (r"depth must be \[h, w\] of positive", lambda b=b: guided_depth(DEPTH.clamp(max=b), IMAGE))
        for b in (0.0, -1.0, math.nan)
    ),
    ("depth must be", lambda: guided_depth(LAYERS[0], IMAGE)),
    ("depth_repair must be one of auto, off, got True", lambda: RandomDefocus(depth_repair=True)),
    *of(
        {},
        tiled,
        ("depth_repair must be one of auto, off, got 'on'", {"depth_repair": "on"}),
        ("edge_width must be 0 to 100 px, got -1", {"edge_width": -1.0}),
        ("edge_width must be", {"edge_width": math.nan}),
        ("edge_width must be 0 to 100 px, got 101", {"edge_width": 101}),
        ("edge_width=4 contradicts depth_repair='off'", {"depth_repair": "off", "edge_width": 4.0}),
    ),
    ("foclen must be one number, got '50mm'; lengths are in mm", lambda: lens("50mm")),
    (r"sensor_size must be \(width, height\), got 36", lambda: DefocusLens(50, 2, 36, 48)),
    ("device must be one of torch's, got 'gpu'", lambda: lens(device="gpu")),
    ("device must be one that is there, got 'xpu:9'; .* use cpu", lambda: lens(device="xpu:9")),
    ("dtype must be floating point, got 'float32'", lambda: lens(dtype="float32")),
    ("foclen must be one number, got True", lambda: lens(True)),
    ("foclen must be positive and finite, got 0", lambda: lens(0)),
    ("fnum must be positive", lambda: lens(fnum=math.nan)),
    ("0.0375 mm across and 0.0444", lambda: DefocusLens(50, 1.4, (36, 24), (960, 540))),
    ("foc_dist must be one number, got None", lambda: lens().refocus(None)),
    ("coc must be positive", lambda: lens().hyperfocal(0.0)),
    ("psf_type must be one of", lambda: lens().psf(torch.ones(3) * 2e3, psf_type="airy")),
    ("at least 1 each", lambda: lens().psf_map(grid=(0, 3))),
    ("at least 1 each", lambda: lens().psf_map_dp(grid=(2, 0))),
    ("depth must be a number .*, got '1m'; .* without a unit", lambda: lens().coc("1m")),
    (r"coc must .* of \[3\] .* got \[2\]", lambda: lens().dof(torch.ones(3) * 900, torch.ones(2))),
    (r"points must be \[N, 3\]", lambda: lens().psf([[0, 0]])),
    ("ks must be a whole number, .* got None", lambda: lens().psf(torch.ones(3), ks=None)),
    ("ks must be a whole number, .* got nan", lambda: lens().psf(torch.ones(3), ks=math.nan)),
    (r"grid must be \(rows, columns\), .* got 5", lambda: lens().psf_map(5)),
    ("ks must be a whole number, .* got True", lambda: lens().psf(torch.ones(3), ks=True)),
    ("depth must be one number", lambda: lens().psf_map(depth=torch.ones(2))),
    ("image .* got ndarray of float32", lambda: lens().render_rgbd(IMAGE[None].numpy(), DEPTHS)),
    ("depth must be .* got None", lambda: lens().render_rgbd(IMAGE[None], None)),
    ("psf_ks must be a whole number", lambda: lens().render_rgbd(IMAGE[None], DEPTHS, "64")),
    (
        "signed_radius must be within 1e.08 px",
        lambda: lens().render_rgbd(IMAGE[None], DEPTHS / 1e9),
    ),
    ("signed_radius must be .* of the image", lambda: render(IMAGE, 3.0)),
    ("signed_radius must be .*complex64", lambda: render(IMAGE, RADIUS.to(torch.complex64))),
    ("num_layers must be a whole number, .* 2.5", lambda: render(IMAGE, RADIUS, num_layers=2.5)),
    ("num_layers must be 65536 at most, got 1000", lambda: render(IMAGE, RADIUS, num_layers=10**9)),
    (r"quality must be one of .*, got \['high'\]", lambda: render(IMAGE, RADIUS, quality=["high"])),
    ("threads must be a whole number", lambda: render(IMAGE, RADIUS, threads=1.5)),
    ("tile must be a whole number", lambda: render(IMAGE, RADIUS, tile=math.inf)),
    ("tile must be at least 16, got 15", lambda: render(IMAGE, RADIUS, tile=15)),
    (r"image must be \[C, H, W\]", lambda: tiled(radius=RADIUS[:-1])),
    ("infinity must be a finite radius", lambda: render(IMAGE, RADIUS, infinity=math.nan)),
    ("aperture must be an Aperture, got 6", lambda: render(IMAGE, RADIUS, aperture=6)),
    ("hidden must be a HiddenLayer", lambda: render(IMAGE, RADIUS, hidden=(IMAGE, RADIUS))),
    ("left_right must be True or False, got 'no'", lambda: render(IMAGE, RADIUS, left_right="no")),
    ("depth must be positive, .* in 768 of 768", lambda: drawn(max_radius=3.0, depth=-DEPTHS)),
    ("left_right must be True or False, got 2", lambda: tiled(left_right=2)),
    ("blades must be a whole number", lambda: Aperture(3.5)),
    ("blades must be 10000 at most", lambda: Aperture(10**6)),
    ("rotation must be one number", lambda: Aperture(6, "15")),
    (r"Aperture\(image=…\)", lambda: lens(aperture=PupilImage(LEFT))),
    (r"Aperture\(image=…\)", lambda: render(IMAGE, RADIUS, aperture=PupilImage(LEFT))),
    (r"foclen must be one number, got \(24, 50\); in mm", lambda: drawn(foclen=(24, 50))),
    (r"blades must be a whole number", lambda: drawn(blades=(0, 6))),
    ("sensor_width must be one number, got None", lambda: drawn(sensor_width=None)),
    ("threads must be at least 1", lambda: drawn(threads=0)),
    ("image must hold a pixel", lambda: drawn(IMAGE[:0][None])),
    ("depth must be a number .* got torch.bool", lambda: drawn(depth=DEPTHS > 0)),
    ("threads must be at least 1", lambda: tiled(threads=0)),
    ("image must be of floats of torch, got torch.uint8", lambda: tiled((255 * IMAGE).byte())),
    ("of a pixel at least", lambda: tiled(IMAGE[:0])),
    ("hidden must be color, signed_radius", lambda: tiled(hidden=(IMAGE, RADIUS, RADIUS[1:]))),
    *(
        (words, lambda k=kind, v=values: Distribution(k, v))
        for kind, values, words in (
            ("normal", (1, 2), "must be one of uniform, .*, got 'normal'; name one of them"),
            ("uniform", (1,), "must have two numbers as ends, got 1"),
            ("uniform", (2, 1), "must begin at the lower end, got 2 and 1"),
            ("loguniform", (0, 1), "must have ends above 0"),
            ("loguniform", (1, math.inf), "must have finite ends"),
            ("percentile", (5, 101), "must lie between 0 and 100"),
            ("choice", (), "must have values to choose from"),
        )
    ),
    *of(
        {},
        RandomDefocus,
        ("fnum must be positive", {"fnum": Distribution("uniform", (0, 2))}),
        ("fnum must not be drawn from a disp", {"fnum": Distribution("disparity", (1, 2))}),
        ("max_radius must be", {"max_radius": 0.0}),
        ("blades must be whole", {"blades": Distribution("uniform", (5, 9))}),
        ("blades must be 0 or at least 3", {"blades": Distribution("choice", (0, 2))}),
        ("obstruction must be", {"obstruction": Distribution("uniform", (0.0, 1.0))}),
        ("shift must be", {"cat_eye_shift": 0.9, "cat_eye_size": 0.9}),
        ("crosstalk must be", {"crosstalk": 0.5}),
    ),
    *of(
        {},
        drawn,
        ("seeds must be one .*, a list of 1, got one of 2;", {"seeds": [1, 2]}),
        ("seeds must be one", {"seeds": [1.5]}),
        ("seeds must be one", {"seeds": 7}),
        ("depth must be farther in focus .* last of 100 .* foclen=", {"depth": DEPTHS / 1000}),
        (f"max_radius must allow some lens.* {ATTEMPTS} lenses", {"max_radius": 1e-9}),
    ),
]


@pytest.mark.parametrize(
    ("words", "door"), ROWS, ids=[f"{n}: {row[0]}" for n, row in enumerate(ROWS)]
)
def test_what_makes_no_sense_is_refused_by_name(words, door):
    with pytest.raises(ValueError, match=words) as told:
        door()
    assert re.search("; |one of", str(told.value)), "what would do"
