"""`match`: lenses for which a new set has the radii of another."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import color_exr, depth_exr, read_exr, refused, run, texture

MEASURES = ("coc_mean_px", "coc_p50_px", "coc_p99_px")
HEAD = """
[inputs]
color = "{0}/*_rgb.exr"
depth = "{0}/*_z.exr"
[outputs]
kinds = ["coc"]
[lens]
focal-length = "50mm"
{1}
[sample]
n = 24
seed = 5
"""
FREE = 'fnumber = "loguniform(1, 4)"\nfocus = "disparity(1m, inf)"\n'


def scenes(folder: Path, seed: int, names: str) -> None:
    """Slopes with cards before them: depth in metres."""
    random = np.random.default_rng(seed)
    for name in names:
        near, far = random.uniform(1, 3), random.uniform(6, 30)
        disparity = np.tile(np.linspace(1 / far, 1 / near, 64, dtype=np.float32), (96, 1)).T
        for _ in range(3):
            top, left = random.integers(0, 40, 2)
            disparity[top : top + 24, left : left + 40] = random.uniform(1 / far, 2 / near)
        color_exr(folder / f"{name}_rgb.exr", texture(96, 64))
        depth_exr(folder / f"{name}_z.exr", 1 / disparity)


def batch(folder: Path, inputs: str, sample: str, out: str, lens: str = "") -> Any:
    (folder / "jobs.toml").write_text(HEAD.format(inputs, lens) + sample)
    return run("batch", folder / "jobs.toml", "-o", folder / out)


def entries(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "metadata.jsonl").read_text().splitlines()]


def quartiles(found: Sequence[dict[str, Any]], name: str) -> Any:
    return np.percentile([entry[name] for entry in found], (25, 50, 75))


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a finished batch, ref, and other scenes beside its own."""
    folder = tmp_path_factory.mktemp("sets")
    scenes(folder / "old", 1, "abcd")
    scenes(folder / "new", 2, "pqrs")
    ran = batch(folder, "old", FREE, "ref")
    assert ran.code == 0, ran.err
    return folder


def test_a_set_of_other_scenes_has_the_radii_of_the_set_it_matches(reference: Path) -> None:
    ran = batch(reference, "new", 'match = "ref"', "out")
    assert ran.code == 0, ran.err
    old, new = entries(reference / "ref"), entries(reference / "out")
    for name in MEASURES:
        assert quartiles(new, name) == pytest.approx(quartiles(old, name), rel=0.1, abs=0.1)
    # the same lenses as the old set would not do
    batch(reference, "new", FREE, "free")
    other = entries(reference / "free")
    assert quartiles(other, MEASURES[2]) != pytest.approx(
        quartiles(old, MEASURES[2]), rel=0.1, abs=0.1
    )
    match = json.loads((reference / "out" / "card.json").read_text())["match"]
    for name in MEASURES:
        assert match[name]["reached"]["mean"] == pytest.approx(
            np.mean([entry[name] for entry in new])
        )
        assert match[name]["asked"]["p50"] == pytest.approx(quartiles(old, name)[1], rel=0.1)
    assert "radii and those of the set matched: mean of a picture" in ran.err
    assert "Radii of the set matched" in (reference / "out" / "card.md").read_text()


def test_a_lens_stays_when_pictures_and_lenses_are_added(reference: Path) -> None:
    batch(reference, "new", 'match = "ref"', "out")
    lenses = {entry["sample_id"]: entry["lens"] for entry in entries(reference / "out")}
    scenes(reference / "more", 2, "pqrst")
    (reference / "jobs.toml").write_text(
        HEAD.format("more", "").replace("n = 24", "n = 30") + 'match = "ref"'
    )
    assert run("batch", reference / "jobs.toml", "-o", reference / "more_out").code == 0
    again = {entry["sample_id"]: entry["lens"] for entry in entries(reference / "more_out")}
    assert len(again) == 150
    assert {name: again[name] for name in lenses} == lenses


def test_a_histogram_is_a_table_with_counts(reference: Path) -> None:
    (reference / "h.csv").write_text(
        "coc_mean_px,coc_p50_px,coc_p99_px,count\n2,1.5,6,3\n4,3,12,1\n9,9,9,0\n"
    )
    assert batch(reference, "new", 'match = "h.csv"', "hist").code == 0
    asked = [
        json.loads(line)["lens"]["radii_px"]
        for line in (reference / "hist" / "journal.jsonl").read_text().splitlines()
        if line
    ]
    maximum = np.array(asked)[:, 2]
    assert (maximum.min(), maximum.max()) == (6, 12)
    assert np.median(maximum) < 8
    reached = [entry["coc_p99_px"] for entry in entries(reference / "hist")]
    assert np.mean(reached) == pytest.approx(maximum.mean(), rel=0.1)


def test_fit_writes_lens_files_whose_radii_are_those_of_the_set(reference: Path) -> None:
    for name in "pqrs":
        for kind, file in (("rgb", "rgb"), ("z", "z")):
            (reference / "by" / kind).mkdir(parents=True, exist_ok=True)
            source = reference / "new" / f"{name}_{file}.exr"
            (reference / "by" / kind / f"{name}.exr").write_bytes(source.read_bytes())
    places = (reference / "by" / "rgb", reference / "by" / "z")
    asked = ("--match", reference / "ref", "--seed", "5")
    ran = run("fit", *places, *asked, "-o", reference / "lenses", "--json")
    assert ran.code == 0, ran.err
    for record in json.loads(ran.out)["pairs"]:
        assert record["coc_p99_px"] == pytest.approx(record["asked"]["coc_p99_px"], rel=0.3)
        name = Path(record["picture"]).stem
        out = reference / f"again_{name}"
        words = ("--lens", record["out"], "-o", out, "--outputs", "coc")
        assert run("render", *(p / f"{name}.exr" for p in places), *words).code == 0
        radii = np.abs(read_exr(out / "coc" / f"{name}.exr")["coc"])
        assert np.percentile(radii, 99) == pytest.approx(record["coc_p99_px"], rel=0.01)
    shown = run("fit", *places, "--match", reference / "ref")
    assert "radii in px, and those asked for: mean " in shown.out
    assert shown.out != run("fit", *places, "--match", reference / "ref", "--seed", "1").out
    # the records are a table of radii in turn
    rows = (json.dumps(record) for record in json.loads(ran.out)["pairs"])
    (reference / "found.jsonl").write_text("\n".join(rows))
    assert run("fit", *places, "--match", reference / "found.jsonl").code == 0


@pytest.mark.parametrize(
    ("words", "code", "at"),
    [
        ((), "missing-option", "BLURRED"),
        (("--seed", "1"), "idle-option", "seed"),
        (("--match", "ref", "--exposure"), "contradiction", "--exposure"),
        (("--match", "ref", "--shift"), "contradiction", "--shift"),
        (("blurred", "--match", "ref"), "contradiction", "BLURRED"),
    ],
)
def test_fit_refuses_what_has_no_effect(
    reference: Path, words: tuple[str, ...], code: str, at: str
) -> None:
    refused(run("fit", reference / "a.exr", reference / "z.exr", *words), 2, code, at)


@pytest.mark.parametrize(
    ("sample", "lens", "code", "at"),
    [
        ('match = "nowhere"', "", "wrong-type", ["nowhere"]),
        ('match = "new"', "", "empty", ["new"]),
        ('match = "ref"', 'blur = "8px"\nfocus-value = 2', "contradiction", ["blur"]),
        (
            'match = "ref"\nfnumber = "uniform(1, 2)"',
            "",
            "contradiction",
            ["jobs.toml", "fnumber"],
        ),
        ('match = "ref"', "focus = '2m'", "contradiction", ["jobs.toml", "focus"]),
        ('match = "ref"', "max-coc = '9px'", "contradiction", ["jobs.toml", "max-coc"]),
        ('match = "h.json"', "", "wrong-type", ["h.json"]),
        ('match = "bad.csv"', "", "malformed", ["bad.csv", "line 2"]),
        ('match = "odd.csv"', "", "malformed", ["odd.csv", "line 2"]),
    ],
)
def test_mistakes_are_answered_in_a_line(
    reference: Path, sample: str, lens: str, code: str, at: list[str]
) -> None:
    (reference / "h.json").write_text("{}")
    (reference / "bad.csv").write_text("coc_mean_px\n2\n")
    (reference / "odd.csv").write_text("coc_mean_px,coc_p50_px,coc_p99_px\n2,-1,3\n")
    ran = batch(reference, "new", sample, "never", lens)
    refused(ran, 2 if code == "contradiction" else 3, code, *at)
    assert not (reference / "never").exists()
