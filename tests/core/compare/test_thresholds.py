"""Rules of flags and of a file, and which of them a picture is judged by."""

import numpy as np
import pytest
from command_line import write_exr
from image_files import from_srgb
from planted_faults import _bilateral, _jpeg, shot

from defocus_core import UsageProblem, compare_images
from defocus_core.compare.metrics import METRICS
from defocus_core.compare.thresholds import matches, read_thresholds, rule
from defocus_core.request.quantities import QuantityError


@pytest.mark.parametrize(
    ("text", "bad", "good"),
    [
        ("psnr<45", 44.9, 45.0),
        ("psnr <= 45 dB", 45.0, 45.1),
        ("max>0.02", 0.021, 0.02),
        ("max>=0.02", 0.02, 0.0199),
        ("share>0.1%", 0.0011, 0.001),
        ("ssim<0.99", 0.98, 0.99),
        ("p99.9>1e-3", 0.002, 0.001),
    ],
)
def test_a_rule_says_when_a_picture_is_bad(text, bad, good):
    known = rule(text)
    for value, is_bad in ((bad, True), (good, False), (float("nan"), True)):
        assert known.is_met({known.metric: value}, ()) is is_bad


@pytest.mark.parametrize("name", METRICS)
def test_a_rule_that_lets_everything_through_is_refused(name):
    right, wrong = "><" if METRICS[name].better == "low" else "<>"
    assert rule(f"{name}{right}1").metric == name
    with pytest.raises(QuantityError, match="met by the better pictures"):
        rule(f"{name}{wrong}1")


@pytest.mark.parametrize(
    "text", ["psnr", "psnr<", "psnr=45", "psrn<45", "max>1.2.3", "", "45<psnr"]
)
def test_what_is_no_rule_is_refused(text):
    with pytest.raises(QuantityError):
        rule(text)


def write(folder, text):
    file = folder / "compare.toml"
    file.write_text(text)
    return file


def texts(rules):
    return [each.text for each in rules]


def test_the_last_pattern_that_matches_wins_and_flags_win_over_all(tmp_path):
    file = write(
        tmp_path,
        "fail = ['psnr<45']\nwarn = 'max>0.02'\nover = 0.5\n"
        "[[override]]\nfiles = 'left/*'\nfail = ['psnr<40']\n"
        "[[override]]\nfiles = '*.png'\nfail = ['max>0.01', 'ssim<0.9']\nover = 0.25\n",
    )
    thresholds = read_thresholds(file)
    assert texts(thresholds.rules_of("render/a.exr").fail) == ["psnr<45"]
    assert texts(thresholds.rules_of("left/a.exr").fail) == ["psnr<40"]
    assert texts(thresholds.rules_of("left/a.png").fail) == ["max>0.01", "ssim<0.9"]
    assert texts(thresholds.rules_of("left/a.png").warn) == ["max>0.02"]
    assert thresholds.rules_of("left/a.png").over == 0.25
    flagged = read_thresholds(file, fail=[rule("max>1")], over=0.125).rules_of("left/a.png")
    assert (texts(flagged.fail), flagged.over) == (["max>1"], 0.125)
    assert thresholds.idle(["render/a.exr", "x.png"]) == ["left/*"]


def test_a_pattern_without_a_slash_means_names_in_any_folder():
    assert matches("left/deep/a.exr", "left/*")
    assert matches("left/a.exr", "a.*")
    assert not matches("left/a.exr", "lef")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fial = ['psnr<45']", "did you mean fail?"),
        ("fail = ['psnr>45']", "write psnr<45"),
        ("fail = [45]", "is not a list of rules"),
        ("over = -1", "not a difference of 0 or more"),
        ("over = true", "not a difference of 0 or more"),
        ("[override]\nfiles = '*'", "write [[override]]"),
        ("[[override]]\nfail = ['psnr<45']", "[override 1] files: is missing"),
        ("[[override]]\nfiles = '*'\nfails = []", "did you mean fail?"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(text, words, tmp_path):
    with pytest.raises(UsageProblem) as caught:
        read_thresholds(write(tmp_path, text))
    assert words in str(caught.value)


def test_causes_are_looked_for_only_where_a_rule_needs_one(tmp_path):
    light = np.random.default_rng(0).random((64, 64), np.float32)
    names = {"a": light, "b": light * 1.02, "c": light * 1.0005, "dark": light - 0.5}
    names["cut"] = np.maximum(light - 0.5, 0)
    files = {n: write_exr(tmp_path / f"{n}.exr", Y=np.float32(v)) for n, v in names.items()}

    for text, pair, found in (
        ("max>1", ("a", "b"), False),
        ("max>1e-6", ("a", "b"), True),
        ("found:*", ("a", "b"), True),
        ("found:noise", ("a", "b"), True),
        ("found:clipped", ("a", "b"), False),
        ("found:clipped", ("dark", "a"), False),
        ("found:clipped", ("dark", "cut"), True),  # what is below 0 may be cut off
    ):
        record = compare_images(*(files[name] for name in pair), fail=[text])
        assert bool(record.findings) is found, text
    for other, found in (("c", False), ("b", True)):  # no screen of 8 bits shows 0.05 %
        warn = ["max>1e-6", "hdr-max>0.01"]
        warned = compare_images(files["a"], files[other], fail=["max>1"], warn=warn)
        assert (bool(warned.findings), warned.status) == (found, "warning")


def clear_left(color=0.5, alpha=1.0):
    image = np.full((24, 32, 4), 0.5, np.float32)
    image[:, :16, 3], image[:, 16:, 3] = 0.0, alpha
    image[:, :16, :3] = color
    return image


@pytest.mark.parametrize(
    ("changed", "like", "passes"),
    [
        (clear_left(color=0.9), "render", True),
        (clear_left(color=0.9), "encoder", True),
        (clear_left(color=0.9), "golden", False),
        (clear_left(color=0.9), None, False),
        (clear_left(color=np.nan), "encoder", False),  # which spreads when it is composited
        (clear_left(alpha=0.0), "encoder", False),
        (clear_left(alpha=0.99), "render", True),
    ],
)
def test_colours_that_are_invisible_do_not_fail_and_a_lost_alpha_does(changed, like, passes):
    record = compare_images(clear_left(), changed, like=like)
    assert record.passes == passes
    if passes and changed[0, 0, 0] != 0.5:
        assert record.notes == ("other colours in 384 pixels where A is 0",)


@pytest.mark.parametrize(
    ("change", "passes"),
    [
        (lambda m: _jpeg(m.shown, 85), True),
        (lambda m: _jpeg(m.shown, 95, "4:4:4"), True),
        (lambda m: from_srgb(m.shown) ** (1 / 2.2), False),
        (lambda m: np.where(np.add(*m.yx)[..., None] > 1.2, _bilateral(m.shown), m.shown), False),
        (lambda m: np.clip(m.shown * 1.02, 0, 1), False),
    ],
)
@pytest.mark.parametrize("name", ["spheres", "floor"])
def test_an_encoder_keeps_means_and_loses_detail_everywhere(name, change, passes):
    m = shot(name, 1)
    a, b = ((255 * v + 0.5).astype(np.uint8) for v in (m.shown, change(m)))
    assert compare_images(a, b, like="encoder", diagnose=False).passes == passes


def test_pixels_are_counted():
    a, b = np.zeros((2, 30, 40), np.float32)
    b[:3, :7] = 0.02
    for text, passes in (("pixels>21", True), ("pixels>20", False)):
        assert compare_images(a, b, fail=[text]).passes == passes
    assert compare_images(a, b, fail=["pixels>0"], over=0.02).passes


@pytest.mark.parametrize("text", ["psnr<45", "ssim<0.9"])
def test_alpha_counts_where_rules_look_at_colour_alone(text):
    record = compare_images(clear_left(), clear_left(alpha=0.7), fail=[text])
    assert record.status == "different"
    assert record.notes == ("other values in A, which no rule looks at",)
    assert compare_images(clear_left(), clear_left(alpha=0.7), fail=[text, "max>0.5"]).passes
    assert compare_images(clear_left(), clear_left(alpha=0.99995), fail=[text]).passes


def test_a_lost_alpha_is_different_by_any_rule_but_within_a_mask():
    record = compare_images(clear_left(), clear_left(alpha=0.0), fail=["max>9"])
    assert (record.status, record.findings[0].name) == ("different", "empty")
