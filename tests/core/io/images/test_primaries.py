"""Colours of other primaries: kept by EXR, and made sRGB's for files that are sRGB."""

import struct

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import depth_exr, refused, render, run
from elements import write
from image_files import save

from defocus_core import InputError, read_color, write_image
from defocus_core.io.exr.header import read_headers
from defocus_core.io.images.color_space import (
    encoded_light,
    linear_light,
    linear_to_srgb,
    read_profile,
    srgb_to_linear,
)
from defocus_core.io.images.primaries import (
    NAMED,
    REC_709,
    adaptation,
    between_primaries,
    declared_primaries,
    xyz_of_primaries,
)

WIDE = {name: values for name, values in NAMED.items() if values != REC_709}
D50 = np.array([0.9642, 1.0, 0.8249])
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
NAMES = pytest.mark.parametrize("name", WIDE)


def patches():
    """Linear colours of Rec. 709, [24, 32, 3]."""
    return np.random.default_rng(3).uniform(0.02, 0.98, (24, 32, 3)).astype(np.float32)


def in_primaries(rgb, name):
    matrix = between_primaries(REC_709, WIDE[name])
    return (rgb @ matrix.T).astype(np.float32)


def fixed(*numbers):
    return b"".join(struct.pack(">i", round(number * 65536)) for number in numbers)


def profile(primaries, curve, *, chad=True, **tags):
    """An ICC profile of one curve and a matrix."""
    native = xyz_of_primaries(primaries)
    white = native.sum(1)
    adapted = adaptation(white, D50)
    columns = dict(zip("rgb", (adapted @ native).T, strict=True))
    tags = {
        **{f"{c}XYZ": b"XYZ \0\0\0\0" + fixed(*xyz) for c, xyz in columns.items()},
        **{f"{c}TRC": curve for c in "rgb"},
        "wtpt": b"XYZ \0\0\0\0" + fixed(*(D50 if chad else white)),
        **({"chad": b"sf32\0\0\0\0" + fixed(*adapted.ravel())} if chad else {}),
        **tags,
    }
    start, table, body = 132 + 12 * len(tags), b"", b""
    for tag, data in tags.items():
        table += struct.pack(">4sII", tag.encode(), start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    signatures = (b"none", b"\4\0\0\0", b"mntr", b"RGB ", b"XYZ ", b"acsp")
    head = struct.pack(">I4s4s4s4s4s12x4s28x", start + len(body), *signatures)
    head += fixed(*D50) + bytes(128 - len(head) - 12)
    return head + struct.pack(">I", len(tags)) + table + body


def parametric(kind, *numbers):
    return b"para" + bytes(4) + struct.pack(">HH", kind, 0) + fixed(*numbers)


def exr(path, rgb, **attributes):
    return write(path, dict(zip("RGB", np.moveaxis(rgb, 2, 0), strict=True)), **attributes)


def depth(folder):
    return depth_exr(folder / "z.exr", np.full((24, 32), 3, np.float32))


def png16(path):
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_ap0_to_rec_709_has_the_published_numbers():
    # Academy TB-2014-004 by way of the ACES transforms, which adapt by CAT02: alike to 0.01.
    matrix = between_primaries(WIDE["ACES AP0"])
    published = [[2.5217, -1.1341, -0.3876], [-0.2765, 1.3727, -0.0962], [-0.0154, -0.1530, 1.1684]]
    np.testing.assert_allclose(matrix, published, atol=0.012)


@NAMES
def test_srgb_of_an_exr_is_that_of_its_twin(name, tmp_path):
    rgb = patches()
    twin = exr(tmp_path / "twin.exr", rgb)
    wide = exr(tmp_path / "wide.exr", in_primaries(rgb, name), chromaticities=WIDE[name])
    z = depth(tmp_path)
    for color in (twin, wide):
        assert render(color, z, "-o", tmp_path / "out", "--format", "png16").code == 0
    a, b = (png16(tmp_path / "out" / "render" / f"{n}.png") for n in ("twin", "wide"))
    assert np.abs(a - b).max() < 0.002
    assert f"primaries {name}" in read_color(wide).note


def test_a_hidden_picture_of_other_primaries_is_refused(tmp_path):
    color = exr(tmp_path / "a.exr", patches())
    wide = exr(tmp_path / "wide.exr", patches(), chromaticities=WIDE["ACES AP1"])
    z = depth(tmp_path)
    ran = render(color, z, "--hidden", wide, z, "-o", tmp_path / "out")
    refused(ran, 3, "wrong-type", wide)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("chad", [True, False])
def test_a_profile_is_decoded(tmp_path, suffix, chad):
    rgb = patches()
    encoded = linear_to_srgb(in_primaries(rgb, "Display P3"))
    samples = np.rint(encoded * 65535).astype(np.uint16)
    data = profile(WIDE["Display P3"], parametric(3, *SRGB_CURVE), chad=chad)
    color = read_color(save(tmp_path / f"a.{suffix}", samples, ICCProfile=data))
    assert color.warnings == ()
    assert "primaries Display P3" in color.note
    declared = {k: v for k, v in color.attributes.items() if k != "ICCProfile"}
    write_image(tmp_path / "b.png", color.pixels, bits=16, attributes=declared)
    assert np.abs(png16(tmp_path / "b.png") - linear_to_srgb(rgb)).max() < 0.002
    write_image(tmp_path / "b.exr", color.pixels, attributes=color.attributes)
    found = declared_primaries(read_headers(tmp_path / "b.exr")[0].attributes)
    assert found == pytest.approx(WIDE["Display P3"], abs=1e-3)


def table(light):
    return b"curv" + struct.pack(">4xI", 1024) + np.rint(light * 65535).astype(">u2").tobytes()


X = np.linspace(0, 1, 1024)
CURVES = [
    (b"curv" + bytes(8), 1.0),
    (b"curv" + bytes(4) + struct.pack(">IH", 1, 0x0233) + bytes(2), 0x233 / 256),
    (table(srgb_to_linear(X)), None),
    (table(X), 1.0),
    (table(X**2.2), pytest.approx(2.2, abs=1e-3)),
    (parametric(0, 1.8), pytest.approx(1.8, abs=1e-4)),
    (parametric(1, 2.0, 1.0, 0.0), 2.0),
    (parametric(2, 2.0, 1.0, 0.0, 0.0), 2.0),
    (parametric(3, *SRGB_CURVE), None),
    (parametric(4, *SRGB_CURVE, 0.0, 0.0), None),
]


@pytest.mark.parametrize(
    "curve",
    [
        parametric(1, 2.0, 1.25, -0.25),
        parametric(2, 2.0, 0.5, 0.25, 0.125),
        parametric(3, 1 / 0.45, 1 / 1.099, 0.099 / 1.099, 1 / 4.5, 0.081),  # of Rec. 709
        table(np.where(X > 0.08, ((X + 0.16) / 1.16) ** 3, X / 9.033)),  # of L*
        table(np.where(X < 0.5, X / 2, 1.5 * X - 0.5)),
        # a power of 0, flat, falling, of a slope of 0: these cannot be undone
        b"curv" + bytes(4) + struct.pack(">IH", 1, 0),
        b"curv" + bytes(4) + struct.pack(">I3H", 3, 0, 0, 0),
        b"curv" + bytes(4) + struct.pack(">I3H", 3, 0, 60000, 0),
        parametric(3, 2.4, 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_a_curve_that_is_none_of_these_is_not_applied(curve):
    assert read_profile(profile(WIDE["Adobe RGB"], curve)) is None


@pytest.mark.parametrize("curve", [curve for curve, _ in CURVES])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_number_of_a_profile_comes_back(curve, dtype):
    gamma = read_profile(profile(WIDE["Adobe RGB"], curve)).gamma
    top = np.iinfo(dtype).max
    numbers = np.arange(top + 1, dtype=dtype)[None, :, None].repeat(3, 2)
    light = linear_light(numbers, None, gamma=gamma, associated=False)
    assert np.array_equal(np.rint(encoded_light(light, gamma) * top), numbers)


@pytest.mark.parametrize("name", ["Display P3 Linear sRGB", "sRGB-elle-V4-g10", "sRGB built-in"])
def test_the_curve_of_a_profile_counts_and_never_its_name(name, tmp_path):
    """Light of 0.5 was read as 0.214, since the name of its linear profile has the word sRGB."""
    described = b"desc" + bytes(4) + struct.pack(">I", len(name) + 1) + name.encode() + bytes(79)
    for curve, light in ((parametric(0, 1.0), 0.5), (parametric(0, 2.2), 0.5**2.2)):
        data = profile(REC_709, curve, desc=described)
        half = np.full((24, 32, 3), 32768, np.uint16)
        photo = save(tmp_path / "a.png", half, ICCProfile=data)
        color = read_color(photo)
        assert color.pixels == pytest.approx(light, abs=1e-4)
        assert color.note.endswith(f" by profile '{name}'")
        write_image(tmp_path / "b.png", color.pixels, bits=16, attributes=color.attributes)
        assert np.array_equal(png16(tmp_path / "b.png"), png16(photo))
        assert embedded(tmp_path / "b.png") == data


def test_primaries_without_colours_are_said_where_they_are_needed(tmp_path):
    line = (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.25, 0.25)
    color = read_color(exr(tmp_path / "a.exr", patches(), chromaticities=line))
    with pytest.raises(InputError) as caught:
        write_image(tmp_path / "b.png", color.pixels, attributes=color.attributes)
    assert caught.value.code == "damaged"
    assert not (tmp_path / "b.png").exists()


PARA = parametric(3, *SRGB_CURVE)
PROFILES = {
    "Display P3": profile(WIDE["Display P3"], PARA),
    "Adobe RGB": profile(WIDE["Adobe RGB"], parametric(0, 563 / 256)),
    "ProPhoto": profile((0.7347, 0.2653, 0.1596, 0.8404, 0.0366, 0.0001, 0.3457, 0.3585), PARA),
}


def embedded(path):
    data = oiio.ImageBuf(str(path)).spec().getattribute("ICCProfile")
    return b"" if data is None else bytes(data)


@pytest.mark.parametrize(
    ("name", "suffix", "kind"),
    [
        ("Display P3", "png", "png"),
        ("Adobe RGB", "jpg", "png16"),
        ("ProPhoto", "tif", "tiff"),
        ("Display P3", "webp", "jpg"),
        ("Adobe RGB", "png", "webp"),
    ],
)
def test_a_picture_keeps_its_profile_and_in_focus_its_numbers(name, suffix, kind, tmp_path):
    ramp = np.linspace(0, 255, 24 * 32).reshape(24, 32, 1)
    samples = np.rint(ramp * (1.0, 0.8, 0.6)).astype(np.uint8)
    photo = save(tmp_path / f"a.{suffix}", samples, ICCProfile=PROFILES[name])
    lens = ("--focal-length", "50mm", "--fnumber", "4", "--focus", "3m", "--format", kind)
    ran = run("render", photo, depth(tmp_path), "-o", tmp_path / "out", *lens)
    assert (ran.code, "warning" in ran.err) == (0, False), ran.err
    (made,) = (tmp_path / "out" / "render").iterdir()
    assert embedded(made) == PROFILES[name]
    assert np.abs(png16(made) - png16(photo)).max() < (0.025 if kind in ("jpg", "webp") else 1e-4)


def test_a_picture_is_made_srgb_only_if_that_is_asked_for(tmp_path):
    rgb = patches()
    samples = np.rint(linear_to_srgb(in_primaries(rgb, "Display P3")) * 65535).astype(np.uint16)
    photo = save(tmp_path / "a.png", samples, ICCProfile=PROFILES["Display P3"])
    options = ("--format", "png16", "--color-space", "srgb")
    assert render(photo, depth(tmp_path), "-o", tmp_path / "out", *options).code == 0
    made = tmp_path / "out" / "render" / "a.png"
    assert embedded(made) == b""
    twin = exr(tmp_path / "twin.exr", rgb)
    render(twin, depth(tmp_path), "-o", tmp_path / "out", "--format", "png16")
    assert np.abs(png16(made) - png16(tmp_path / "out" / "render" / "twin.png")).max() < 0.002
    linear = render(photo, depth(tmp_path), "-o", tmp_path / "exr", "--color-space", "srgb")
    refused(linear, 2, "idle-option", "color-space")
