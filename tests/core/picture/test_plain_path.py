"""The plain path of a picture, and the table of what else may happen to it."""

import re
import subprocess
import sys
from inspect import get_annotations
from pathlib import Path

import pytest
from command_line import color_exr, depth_exr
from counting import calls
from jobs_files import job_of

from defocus_core.picture import plain_path, steps
from defocus_core.picture.steps import table

# What reads and writes files of other types than a plain EXR.
OTHER_FILES = {
    *("array_files", "chroma", "color_space", "deep_layers", "deep_samples", "encode"),
    *("file_types", "lens_metadata", "photo_depth", "raster", "sidecars"),
}
STAGES = ("WINDOW", "PAIR", "READ", "LENS", "RADII", "SCENE", "PASSES", "WRITE")
STEPS = [step for stage in STAGES for step in getattr(table, stage)]


def job(folder, **lens):
    files = color_exr(folder / "c.exr"), depth_exr(folder / "z.exr")
    return job_of(*files, folder / "out", **lens)


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_a_step_is_a_function_of_its_stage(step):
    takes, gives = get_annotations(step.function).values()
    assert takes == gives, "what a stage hands on"


def test_each_module_of_a_step_is_in_the_table():
    modules = {path.stem for path in Path(steps.__path__[0]).glob("*.py")}
    named = {step.name.partition(":")[0] for step in STEPS}
    assert {f"steps.{name}" for name in modules - {"__init__", "table"}} <= named


def test_the_plain_path_knows_no_step():
    folder = Path(steps.__path__[0]).parent
    for path in folder.glob("*.py"):
        known = set(re.findall(r"picture\.steps\.(\w+) import", path.read_text()))
        assert known <= {"table"}, path


def test_no_step_knows_another():
    for path in Path(steps.__path__[0]).glob("*.py"):
        known = set(re.findall(r"picture\.steps\.(\w+) import", path.read_text()))
        assert known == set(), path


def test_what_does_not_apply_is_not_imported(tmp_path):
    (tmp_path / "out").mkdir()
    files = color_exr(tmp_path / "c.exr"), depth_exr(tmp_path / "z.exr")
    words = ["--focal-length", "50mm", "--fnumber", "2", "--focus", "2m", "-o", "out"]
    code = (
        "import atexit, sys; from defocus_cli.main import main\n"
        "atexit.register(lambda: print(*sys.modules)); main()"
    )
    command = [sys.executable, "-c", code, "render", *map(str, files), *words]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    names = [name for name in ran.stdout.split() if name.startswith("defocus_core.")]
    loaded = {name.split(".")[-1] for name in names if f"{steps.__name__}." in name}
    assert loaded == {"table"}
    assert {name.split(".")[-1] for name in names}.isdisjoint(OTHER_FILES)


def test_the_header_of_each_file_is_parsed_once(tmp_path):
    asked = job(tmp_path)
    assert calls(lambda: plain_path.read(asked), "raw_headers") == 2
