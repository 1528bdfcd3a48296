"""``defocus compare``: exit codes, what is compared, and what is reported."""

import json
import struct
import zlib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import files_under, read_exr, refused, run, write_exr
from deep_files import write_deep_samples
from elements import write
from image_files import from_srgb, save
from planted_faults import HEIGHT, WIDTH, planes, scene

from defocus_core.compare.run import CAUSES, Task

PATCH = (slice(20, 30), slice(50, 60))


@pytest.fixture
def a(tmp_path):
    return write(tmp_path / "a.exr", planes(scene()))


@pytest.fixture
def b(tmp_path):
    """The scene with 100 pixels brighter by 0.25."""
    return write(tmp_path / "b.exr", planes(patched()))


def patched():
    image = scene()
    image[PATCH] += 0.25
    return image


def the_pair(*args):
    (record,) = run("compare", *args, "--json").json["pairs"]
    return dict(record)


def folders(root):
    """Two folders: one picture the same, one that differs, one missing, one further."""
    for name in ("A/same", "A/sub/other", "A/lone", "B/same"):
        write(root / f"{name}.exr", planes(scene()))
    write(root / "B" / "new.exr", planes(patched()))
    write(root / "B" / "sub" / "other.exr", planes(patched()))
    (root / "A" / "journal.jsonl").write_text("{}")
    return root / "A", root / "B"


def test_the_same_file_is_the_same(a):
    ran = run("compare", a, a)
    assert (ran.code, ran.out, ran.err) == (0, "a.exr: same\n", "")


def test_an_interrupted_run_has_reported_what_it_did(tmp_path, monkeypatch):
    pair = folders(tmp_path)
    compared: list[str] = []

    def interrupted(self, piece):
        if len(compared) == 2:
            raise KeyboardInterrupt
        compared.append(piece[0].name)
        return carry_out(self, piece)

    carry_out = Task.carry_out
    monkeypatch.setattr(Task, "carry_out", interrupted)
    ran = run("compare", *pair, "--verbose", "--junit", tmp_path / "pairs.xml")
    assert ran.code == 130
    first, second, summary = ran.out.splitlines()
    assert (first, second) == (
        "lone.exr: MISSING: B has no such file",
        "new.exr: EXTRA: A has no such file",
    )
    assert summary == "4 pairs: 1 missing, 1 extra, 2 not compared"
    assert len(ElementTree.parse(tmp_path / "pairs.xml").getroot()[0]) == 2
    compared.clear()
    ran = run("compare", *pair, "--json")
    document = json.loads(ran.out)
    assert (document["same"], document["not_compared"]) == (False, 2)
    assert len(document["pairs"]) == 2


@pytest.mark.parametrize(("causes", "named"), [("first", 2), ("all", 4), ("none", 0)])
def test_causes_are_sought_in_the_first_that_fail(causes, named, tmp_path, monkeypatch):
    monkeypatch.setitem(CAUSES, "first", 2)
    for k in range(6):
        for folder, image in (("A", scene()), ("B", scene() if k in (0, 1) else 2 * scene())):
            write(tmp_path / folder / f"{k}.exr", planes(image))
    words = ["compare", tmp_path / "A", tmp_path / "B", "--causes", causes, "--json"]
    pairs = run(*words).json["pairs"]
    said = [pair["name"] for pair in pairs if pair["findings"]]
    assert said == [f"{k}.exr" for k in range(2, 2 + named)]
    ruled = run(*words, "--fail", "found:another exposure").json["pairs"]
    assert [pair["status"] for pair in ruled] == ["same"] * 2 + ["different"] * 4


def test_no_rule_is_proposed_that_lets_anything_pass(a, tmp_path):
    other = np.random.default_rng(3).random(scene().shape) * 20
    b = write(tmp_path / "b.exr", planes(other))
    assert the_pair(a, b)["proposal"] is None
    bright = write(tmp_path / "bright.exr", planes(1.2 * scene()))
    assert the_pair(a, bright)["proposal"] is None  # its cause is known
    patch = write(tmp_path / "patch.exr", planes(patched()))
    assert the_pair(a, patch, "--fail", "max>0.01")["proposal"] is None  # one is given


def test_a_difference_is_told_with_the_worst_pixel_and_a_rule_that_lets_it_pass(a, b):
    ran = run("compare", a, b)
    assert ran.code == 1
    (line,) = ran.out.splitlines()
    assert line.startswith(
        "b.exr: DIFFERENT: in one region of 10x10 at 50,20: 100% of the difference"
    )
    assert "worst at 5" in line
    assert "(R G B: " in line
    proposed = line.split("--fail '")[1].split("'")[0]
    assert run("compare", a, b, "--fail", proposed).code == 0


@pytest.mark.parametrize(
    ("rules", "code", "words"),
    [
        (["--fail", "max>0.3"], 0, "b.exr: same"),
        (["--fail", "max>0.3", "--warn", "max>0.2"], 0, "b.exr: warning: "),
        (["--fail", "max>0.3", "--fail", "psnr<99"], 1, "fails psnr<99"),
        (["--fail", "share>1%", "--over", "0.2"], 0, "b.exr: same"),
        (["--fail", "share>0.5%", "--over", "0.2"], 1, "fails share>0.5%"),
        (["--fail", "share>0.5%", "--over", "0.3"], 0, "b.exr: same"),
        (["--warn", "max>0.2"], 1, "DIFFERENT"),
        (["--fail", "flip>0"], 1, "has no flip>0"),
    ],
)
def test_rules_decide(rules, code, words, a, b):
    ran = run("compare", a, b, *rules)
    assert ran.code == code
    assert words in ran.out


def test_region_and_mask_choose_the_pixels(a, b, tmp_path):
    assert run("compare", a, b, "--region", "0,0,50,90").code == 0
    inside = the_pair(a, b, "--region", "55,25,20,20")
    assert inside["differing_pixels"] == 25
    assert inside["differing_window"] == [55, 25, 5, 5]
    assert (inside["worst"]["x"], inside["worst"]["y"]) >= (55, 25)
    hole = np.ones((HEIGHT, WIDTH, 1), np.uint8)
    hole[PATCH] = 0
    mask = save(tmp_path / "mask.png", hole)
    assert run("compare", a, b, "--mask", mask).code == 0
    other = save(tmp_path / "inverse.png", 1 - hole)
    assert run("compare", a, b, "--ignore-mask", other).code == 0
    assert run("compare", a, b, "--ignore-mask", mask).code == 1
    assert run("compare", a, b, "--ignore-mask", mask, "--mask", mask).code == 3  # nothing is left
    assert the_pair(a, b, "--mask", other)["metrics"]["mean"] == pytest.approx(0.25, rel=1e-2)


def test_channels_are_chosen_and_left_out(tmp_path):
    planes = {n: np.full((20, 30), 0.5, np.float32) for n in ("R", "G", "B", "A", "rand.R")}
    a = write_exr(tmp_path / "a.exr", **planes)
    b = write_exr(tmp_path / "b.exr", **{**planes, "rand.R": planes["R"] / 3, "id": planes["R"]})
    rules = tmp_path / "compare.toml"
    rules.write_text('[[override]]\nfiles = "b.*"\nignore-channels = ["rand.*", "id"]')
    for words, code in (
        *(([], 1), (["--ignore-channels", "[!RGB]*"], 0), (["--ignore-channels", "rand.*"], 1)),
        *((["--ignore-channels", "rand.*,id"], 0), (["--thresholds", rules], 0)),
    ):
        assert run("compare", a, b, *words).code == code, words
    ran = run("compare", a, b, "--ignore-channels", "*")
    assert (ran.code, "has only R, G, B, A, rand.R" in ran.out) == (3, True)


def test_edges_that_are_anti_aliased_are_tolerated_and_no_more(tmp_path):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    soft = np.clip(0.9 * x + 0.35 * y - 40.2, 0, 1).astype(np.float32)
    shaded = np.where(np.hypot(y - 20, x - 70) < 5, np.float32(0.8), soft)
    waves = 0.9 * x + 0.5 * y
    texture = (0.5 + 0.4 * np.sin(waves)).astype(np.float32)
    is_steep = (x % 4 == 2) & (y % 4 == 2) & (np.abs(np.cos(waves)) > 0.8)
    other = texture + np.float32(0.1) * is_steep
    images = {"hard": np.rint(soft), "soft": soft, "shaded": shaded}
    images |= {"texture": texture, "other texture": other}
    files = {n: write_exr(tmp_path / f"{n}.exr", Y=v) for n, v in images.items()}
    assert run("compare", files["hard"], files["soft"]).code == 1
    for a, b, code in (
        *(("hard", "soft", 0), ("soft", "hard", 0)),
        *(("hard", "shaded", 1), ("texture", "other texture", 1)),
    ):
        assert run("compare", files[a], files[b], "--tolerate-edges").code == code, (a, b)


def test_samples_of_deep_pictures_are_compared_though_others_hide_them(tmp_path):
    def written(name, *lights):
        samples = [
            {"R": light, "G": light, "B": light, "A": 1.0, "Z": 1.0 + k}
            for k, light in enumerate(lights)
        ]
        return write_deep_samples(tmp_path / f"{name}.exr", [[samples] * 20] * 14)

    a, same = (written(name, 0.5, 0.25) for name in ("a", "same"))
    other, lost = written("other", 0.5, 0.75), written("lost", 0.5)
    assert run("compare", a, same).code == 0
    for b, words in ((other, "R by up to 0.5"), (lost, "another number in 280 pixels")):
        ran = run("compare", a, b)
        assert ran.code == 1
        assert "DIFFERENT: deep samples: " in ran.out
        assert words in ran.out
        assert run("compare", a, b, "--fail", "max>1").code == 0
    flat = np.ones((14, 20), np.float32)
    planes = {**dict.fromkeys("RGB", flat / 2), "A": flat, "Z": flat}
    assert run("compare", a, write_exr(tmp_path / "flat.exr", **planes)).code == 0
    del planes["Z"]  # a flat picture has no depth
    assert run("compare", a, write_exr(tmp_path / "flat.exr", **planes)).code == 0
    planes["R"] = planes["R"] / 2
    assert run("compare", write_exr(tmp_path / "flat.exr", **planes), a).code == 1


@pytest.mark.parametrize("kind", ["text", "cut", "empty"])
def test_a_file_that_cannot_be_read_is_never_the_same(kind, a, tmp_path):
    bad = tmp_path / "bad.exr"
    bad.write_bytes({"text": b"no picture", "cut": a.read_bytes()[:-300], "empty": b""}[kind])
    for pair in ((a, bad), (bad, a), (bad, bad)):
        ran = run("compare", *pair)
        assert ran.code == 3
        assert "UNREADABLE" in ran.out


def test_folders_pair_by_path_and_a_lone_file_is_a_difference(tmp_path):
    ran = run("compare", *folders(tmp_path))
    assert ran.code == 1
    assert [line.split(": ")[:2] for line in ran.out.splitlines()] == [
        ["lone.exr", "MISSING"],
        ["new.exr", "EXTRA"],
        ["sub/other.exr", "DIFFERENT"],
        ["4 pairs", "1 same, 1 different, 1 missing, 1 extra"],
    ]
    assert "same.exr: same" in run("compare", *folders(tmp_path), "-v").out


def test_every_file_that_looks_like_a_picture_or_an_array_is_compared_or_named(tmp_path):
    grey = {"A": 0.2, "B": 0.8}
    for folder, value in grey.items():
        for kind in ("webp", "bmp", "tga", "ppm", "dpx"):
            path = tmp_path / folder / f"a.{kind}"
            path.parent.mkdir(exist_ok=True)
            save(path, np.full((8, 8, 3), int(255 * value), np.uint8))
        np.savez(tmp_path / folder / "other.npz", np.full((4, 4), value))
        np.savez(tmp_path / folder / "same.npz", np.ones((4, 4)))
    (tmp_path / "A/lone.jxl").write_bytes(b"lone")
    animated = (tmp_path / "A/a.webp").with_name("moves.png")
    save(animated, np.zeros((8, 8, 1), np.uint8))
    data = animated.read_bytes()
    control = struct.pack(">I4sII", 8, b"acTL", 2, 0)
    for folder in grey:
        (tmp_path / folder / "moves.png").write_bytes(
            data[:33] + control + struct.pack(">I", zlib.crc32(control[4:])) + data[33:]
        )
    ran = run("compare", tmp_path / "A", tmp_path / "B")
    found = dict(line.split(": ")[:2] for line in ran.out.splitlines()[:-1])
    kinds = {f"a.{kind}": "DIFFERENT" for kind in ("bmp", "dpx", "ppm", "tga", "webp")}
    rest = {"lone.jxl": "MISSING", "moves.png": "UNREADABLE", "other.npz": "UNREADABLE"}
    assert found == kinds | rest
    assert ran.out.splitlines()[-1].startswith("9 pairs: 1 same, 5 different")


def test_many_pairs_in_processes_are_reported_in_order_and_alike(tmp_path):
    for folder in "AB":
        for number in range(9):
            image = scene()[:24, :32] + (0.1 * number if folder == "B" else 0)
            write(tmp_path / folder / f"{number}.exr", planes(image))
    alone, together = (
        run("compare", tmp_path / "A", tmp_path / "B", "--json", "--processes", n) for n in "12"
    )
    assert alone.out == together.out
    assert [pair["name"] for pair in alone.json["pairs"]] == [f"{n}.exr" for n in range(9)]
    assert alone.json["counts"]["different"] == 8


def test_a_file_of_thresholds_has_rules_for_patterns(tmp_path):
    pair = folders(tmp_path)
    (tmp_path / "A" / "lone.exr").unlink()
    (tmp_path / "B" / "new.exr").unlink()
    file = tmp_path / "compare.toml"
    file.write_text("[[override]]\nfiles = 'sub/*'\nfail = ['max>0.3']\n")
    assert run("compare", *pair, "--thresholds", file).code == 0
    file.write_text("[[override]]\nfiles = 'sbu/*'\nfail = ['max>0.3']\n")
    ran = run("compare", *pair, "--thresholds", file)
    assert ran.code == 1
    assert "no picture matches files = 'sbu/*'" in ran.err


def test_flip_of_greys_is_that_of_the_paper(tmp_path):
    """Grey of sRGB 0.5 and 0.55: HyAB of L* 53.39 and 58.35, to the power 0.7, mapped to 0…0.95."""
    pytest.importorskip("flip_evaluator")
    grey = np.ones((64, 64), np.float32)
    light, shown = [], []
    for value in (0.5, 0.55):
        linear = from_srgb(value * grey).astype(np.float32)
        light.append(write_exr(tmp_path / f"{value}.exr", Y=linear))
        stored = np.rint(value * 65535 * grey[..., None]).astype(np.uint16)
        shown.append(save(tmp_path / f"{value}.png", stored))
    for pair in (light, shown):
        assert the_pair(*pair, "--flip")["metrics"]["flip"] == pytest.approx(0.1767, abs=1e-3)


def test_a_summary_for_a_pull_request_has_a_table_the_worst_and_what_happened(tmp_path):
    pair = folders(tmp_path)
    hostile = "@you|[a](b)<i>.exr"
    write(pair[0] / hostile, planes(scene()))
    write(pair[1] / hostile, planes(np.roll(scene(), 2, 1)))
    file = tmp_path / "reports" / "summary.md"
    assert run("compare", *pair, "--markdown", file, "--diff", tmp_path / "diff").code == 1
    text = file.read_text()
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[1] for row in rows[1:]] == ["different"] * 2 + ["extra", "missing"]
    assert not {"@", "<i", "[a"} & {text[k : k + n] for k in range(60, len(text)) for n in (1, 2)}
    assert "shifted (1)" in text
    assert "](../diff/sub/other.exr.diff.png)" in text
    again = run("compare", *pair, "--markdown", file, "--fail", "max>99")
    assert "2 same" not in file.read_text()
    assert again.code == 1
    file.write_text("mine")
    refused(run("compare", *pair, "--markdown", file), 3, "exists", file)


@pytest.mark.parametrize("option", ["--junit", "--html", "--markdown"])
def test_a_report_that_cannot_be_written_leaves_the_json(option, a, tmp_path):
    b = write(tmp_path / "b.exr", planes(2 * scene()))
    ran = run("compare", a, b, "--json", option, b / "report", "--accept")
    assert ran.code == 3
    assert [pair["status"] for pair in ran.json["pairs"]] == ["different"]
    assert [error["problem"] for error in ran.json["failed"]]
    assert ran.json["accepted"] == []


def test_there_is_no_difference_image_of_another_size_and_that_is_said(a, tmp_path):
    b = tmp_path / "b.exr"
    write_exr(b, **{name: plane[:9, :9] for name, plane in read_exr(a).items()})
    ran = run("compare", a, b, "--diff", tmp_path / "diff")
    assert "no difference images" in ran.out
    assert not (tmp_path / "diff").exists()


def test_difference_images_are_signed_and_amplified(a, tmp_path):
    image = patched()
    image[0, 0] = np.nan
    b = write(tmp_path / "b.exr", planes(image))
    pair = the_pair(a, b, "--diff", tmp_path / "diff")
    assert files_under(tmp_path / "diff") == {"b.exr.diff.exr", "b.exr.diff.png"}
    assert [Path(path).name for path in pair["images"]] == ["b.exr.diff.exr", "b.exr.diff.png"]
    signed = read_exr(tmp_path / "diff" / "b.exr.diff.exr")
    assert np.isnan(signed["R"][0, 0])
    assert signed["R"][25, 55] == pytest.approx(0.25, rel=1e-2)
    assert signed["R"][60, 60] == 0.0
    shown = oiio.ImageBuf(str(tmp_path / "diff" / "b.exr.diff.png")).get_pixels(oiio.UINT8)
    assert shown[0, 0].tolist() == [255, 0, 255]
    assert shown[60, 60].tolist() == [128, 128, 128]
    assert shown[25, 55, 0] == pytest.approx(128 + 2 * 0.25 * 127, abs=1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1)])
def test_the_cause_is_looked_for_in_thin_pictures(size, tmp_path):
    for seed, name in enumerate("ab"):
        noise = np.random.default_rng(seed).random((*size, 3), np.float32)
        write(tmp_path / f"{name}.exr", planes(noise))
    ran = run("compare", tmp_path / "a.exr", tmp_path / "b.exr")
    assert (ran.code, ran.err) == (1, "")


def test_numbers_beyond_all_bounds_are_different_and_no_fault(tmp_path):
    for name, value in (("a", -1e308), ("b", 1.7e308)):
        np.save(tmp_path / f"{name}.npy", np.full((20, 30), value))
    ran = run("compare", tmp_path / "a.npy", tmp_path / "b.npy", "--json", "--diff", tmp_path / "d")
    (pair,) = ran.json["pairs"]
    assert (ran.code, ran.err, pair["metrics"]["max"]) == (1, "", "Inf")


def test_junit_has_a_case_for_each_pair(tmp_path):
    pair = folders(tmp_path)
    strange = pair[1] / "<script>&\x07.exr"
    strange.write_bytes(b"no picture")
    (pair[0] / strange.name).write_bytes(b"no picture")
    file = tmp_path / "reports" / "compare.xml"
    assert run("compare", *pair, "--junit", file).code == 3
    suite = ElementTree.parse(file).getroot()[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("5", "3", "1")
    cases = {case.get("name"): case for case in suite}
    assert len(cases["same.exr"]) == 0
    assert cases["other.exr"].get("classname") == "compare.sub"
    assert "max 0.25" in str(cases["other.exr"][0].get("message"))
    assert cases["<script>&\\x07.exr"][0].tag == "error"
