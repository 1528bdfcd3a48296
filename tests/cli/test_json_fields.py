"""`defocus help json` names each field that commands print, and no other."""

import re

import numpy as np
import pytest
from command_line import LENS, color_exr, depth_exr, photograph, run, succeed, topic, write_exr
from deep_files import write_deep_samples
from elements import disc, element
from jobs_files import FIXED, INPUTS, jobs_file, pictures

from defocus_core.evaluation import lens_laws
from defocus_core.request.parameters import EFFECT_OPTIONS, RECORDED

SECTIONS = dict(re.findall(r"(?ms)^## (.*?)\n(.*?)(?=^## |\Z)", topic("json")))
COMMANDS = [
    name.strip("`").removeprefix("defocus ")
    for name in SECTIONS
    if "`" in name and "bench" not in name
]
CREW = ("--processes", "1", "--threads", "1")


def documented(section):
    """The fields that the topic names; ``x.*`` are names that may be any."""
    cells = re.findall(r"(?m)^\| (`.*?) \|", SECTIONS[section])
    return {name for cell in cells for name in re.findall(r"`([\w.*]+)`", cell)}


def fields(value, known, at=""):
    """The fields of a document that hold no others, as the topic writes them."""
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        return set().union(*(fields(each, known, at) for each in value))
    if f"{at}.*" in known:
        return {f"{at}.*"}
    if not isinstance(value, dict):
        return {at}
    below = (fields(each, known, f"{at}.{name}" if at else name) for name, each in value.items())
    return set().union(*below)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """Inputs of all commands, and what some of them made."""
    desk = tmp_path_factory.mktemp("desk")
    pictures(desk)
    photograph(
        desk / "a_rgb.exr", desk / "a_z.exr", "-o", desk / "out", "--outputs", "render,coc,trust"
    )
    write_deep_samples(desk / "deep.exr", [[[dict.fromkeys("RGBAZ", 0.5)]] * 9] * 9)
    write_exr(desk / "element.exr", **element(disc()))
    for number in (1, 2):
        depth_exr(desk / f"d.{number:04}.exr")
    (desk / "bad.exr").write_bytes(b"no picture")
    color_exr(desk / "sharp.exr", np.random.default_rng(1).random((48, 64, 3), np.float32))
    metres = np.linspace(4, 1.2, 48, dtype=np.float32)[:, None].repeat(64, 1)
    blurred = ("-o", desk / "pair", "--outputs", "left,right", "--fnumber", "1")
    photograph(desk / "sharp.exr", depth_exr(desk / "metres.exr", metres), *blurred)
    jobs = jobs_file(desk, FIXED, inputs=INPUTS)
    for name in ("failing", "other"):
        (desk / name).mkdir()
    jobs_file(desk / "failing", FIXED)
    succeed("batch", jobs, "-o", desk / "b", *CREW)
    other = FIXED.replace("= 2", "= 4")
    jobs_file(desk / "other", other, inputs=INPUTS.replace('"*', '"../*'))
    succeed("batch", desk / "other" / "jobs.toml", "-o", desk / "c", *CREW)
    run("batch", desk / "failing" / "jobs.toml", "-o", desk / "f", *CREW)
    return desk


def lines(command, desk):
    """Command lines that together print all fields of a command."""
    pair, out = (desk / "a_rgb.exr", desk / "a_z.exr"), desk / "out"
    views = (desk / "pair" / "left" / "sharp.exr", "--right", desk / "pair" / "right" / "sharp.exr")
    jobs, taken = desk / "jobs.toml", out / "render" / "a_rgb.exr"
    return {
        "render": [(*pair, *LENS, "-o", desk / "r")],
        "render --dry-run": [(*pair, *LENS, "-o", desk / "r2")],
        "batch": [(jobs, "-o", desk / "b3", *CREW)],
        "status": [(desk / "b",), (desk / "f",)],
        "merge": [(desk / "b",)],
        "info": [
            (*LENS, *pair, desk / "bad.exr"),
            (*LENS, desk / "deep.exr", desk / "element.exr"),
            (*LENS, out / "coc" / "a_rgb.exr", out / "trust" / "a_rgb.exr"),
            (*LENS, taken, pair[1]),
            (*LENS, desk / "d.####.exr"),
        ],
        "depth": [(pair[1], desk / "bad.exr", "-o", desk / "depths")],
        "lenses": [()],
        "fit": [(desk / "sharp.exr", desk / "metres.exr", *views, "--dual-pixel")],
        "compare": [(pair[0], taken), (desk / "b", desk / "c")],
        "verify": [()],
    }[command]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_topic_names_each_field_of_a_command_and_no_other(command, desk, monkeypatch):
    monkeypatch.setattr(lens_laws, "LAWS", lens_laws.LAWS[:1])  # whose check has all fields
    known, found = documented(f"`defocus {command}`"), set()
    for line in lines(command, desk):
        found |= fields(run(*command.split(), "--json", *line).json, known)
    held = {name for name in {*known, *found} if any(x.startswith(f"{name}.") for x in known)}
    assert found - {"defocus"} - held == known - held


def test_the_topic_names_each_value_of_a_lens_and_of_a_repair(desk):
    beside = {"focus_at_px", "focus_percentile", "draw"}
    assert documented("A lens") == {*RECORDED, *EFFECT_OPTIONS} | beside
    pair = (desk / "a_rgb.exr", desk / "a_z.exr", "-o", desk / "r3")
    (told,) = run("render", *pair, *LENS, "--dry-run", "--json").json["pictures"]
    assert documented("A repair of depth") == told["forecast"]["depth_repair"].keys()
