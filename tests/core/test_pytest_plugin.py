"""The fixture ``golden`` of other projects: their tests run in a session of their own."""

import contextlib
import io
import re
import shutil
import sys
from pathlib import Path

import pytest
from html_reports import items, keys

XDIST = ("-p", "xdist", "-n", "2")
SHIFTED = "np.roll(image, 1, 1)"
TEST = """
import numpy as np
import pytest

image = np.random.default_rng(0).random((32, 48, 3), np.float32)

def test_a_picture(golden):
    golden.check({expression}, "noise/a"{bounds})
"""


def ran(folder, *options):
    """The exit code of the tests of a folder, and what pytest says."""
    plugin = ["-p", "no:defocus", "-p", "defocus_core.pytest_plugin", "-p", "no:cacheprovider"]
    words = ["-q", *plugin, "--import-mode=importlib", "--capture=no", f"--rootdir={folder}"]
    said = io.StringIO()
    sys.modules.pop("test_it", None)
    with contextlib.chdir(folder), contextlib.redirect_stdout(said):
        code = pytest.main([*words, *options])
    return code, said.getvalue()


def passes(folder, *options, expression="image", bounds=""):
    """None if the test passes, else what pytest says."""
    (folder / "test_it.py").write_text(TEST.format(expression=expression, bounds=bounds))
    code, said = ran(folder, *options, "test_it.py")
    assert code in (0, 1), said
    return said if code else None


@pytest.fixture(scope="module")
def accepted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("accepted")
    (folder / "pytest.ini").write_text("[pytest]\n")
    assert "there is no such golden" in str(passes(folder))
    assert passes(folder, "--golden-update") is None
    assert (folder / "goldens" / "test_it" / "noise" / "a.exr").is_file()
    return folder


@pytest.fixture
def project(accepted, tmp_path):
    """A project whose golden has been accepted."""
    return Path(shutil.copytree(accepted, tmp_path, dirs_exist_ok=True))


@pytest.mark.parametrize(
    "expression",
    [
        "image",
        "image + np.float32(9e-5)",
        "image.astype(np.float64)",
        "__import__('torch').from_numpy(image).permute(2, 0, 1)",
        "__import__('torch').from_numpy(image).permute(2, 0, 1)[None].requires_grad_()",
        "'goldens/test_it/noise/a.exr'",
    ],
)
def test_what_is_like_the_golden_passes(expression, project):
    assert passes(project, expression=expression) is None


def test_what_is_not_fails_with_its_cause(project):
    said = str(passes(project, expression=SHIFTED))
    assert "noise/a: DIFFERENT: shifted by (1, 0)" in said
    assert "fails max>1e-4" in said
    assert "lets it pass" not in said  # its cause is known
    assert "--golden-update makes it the golden" in said
    assert passes(project, "--golden-update", expression=SHIFTED) is None
    assert passes(project, expression=SHIFTED) is None


def test_a_bound_is_proposed_where_no_cause_is_found(project):
    patch = "image + np.float32(0.2) * (np.indices((32, 48)).sum(0) < 9)[..., None]"
    found = re.search(r"^max=(\S+) lets it pass$", str(passes(project, expression=patch)), re.M)
    assert passes(project, expression=patch, bounds=f", max={found[1]}") is None
    given = str(passes(project, expression=patch, bounds=", max=0.01"))
    assert "lets it pass" not in given


def test_bounds_decide(project):
    dimmed = "image * np.float32(0.99)"
    assert "another exposure: x 0.99" in str(passes(project, expression=dimmed))
    assert passes(project, expression=dimmed, bounds=", psnr=40, rel_rmse=0.02") is None
    assert "fails p99.9>0.001" in str(passes(project, expression=dimmed, bounds=", p999=1e-3"))
    assert "takes no brightness" in str(passes(project, bounds=", brightness=1"))


@pytest.mark.parametrize("processes", [(), XDIST])
def test_a_report_shows_what_failed(processes, project):
    said = str(passes(project, "--golden-report", "out/r.html", *processes, expression=SHIFTED))
    assert f"report of goldens: {Path('out', 'r.html')}" in said
    (shown,) = items(project / "out" / "r.html")
    assert shown["name"] == "goldens/test_it/noise/a.exr"
    assert shown["words"] == "shifted by (1, 0)"
    assert keys(shown, valued=True)[:2] == ["a", "b"]
    accept = dict(shown["commands"])["Accept as the golden"]
    assert accept == "pytest test_it.py::test_a_picture --golden-update"
    assert passes(project, "--golden-report", "out/r.html") is None
    assert items(project / "out" / "r.html") == []


def test_a_picture_without_a_golden_is_in_the_report(project):
    (project / "goldens" / "test_it" / "noise" / "a.exr").unlink()
    assert passes(project, "--golden-report", "r.html")
    (shown,) = items(project / "r.html")
    assert (shown["status"], keys(shown)) == ("extra", ["b"])


def test_several_pictures_may_be_accepted(project):
    golden = project / "goldens" / "test_it" / "noise" / "a.exr"
    golden.rename(golden.with_name("a.1.exr"))
    assert passes(project) is None
    assert passes(project, "--golden-update", expression=SHIFTED) is None
    assert golden.is_file()
    for expression in ("image", SHIFTED):
        assert passes(project, expression=expression) is None
    assert "DIFFERENT" in str(passes(project, expression="image * 2"))


def test_a_golden_that_is_a_pointer_of_git_lfs_is_named_as_that(project):
    golden = project / "goldens" / "test_it" / "noise" / "a.exr"
    golden.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    said = str(passes(project))
    assert "is a Git LFS pointer, not the file that it stands for; run: git lfs pull" in said
    assert "Traceback" not in said
    assert "InputError" not in said
    before = golden.read_bytes()
    assert "git lfs pull" in str(passes(project, "--golden-update"))
    assert golden.read_bytes() == before


def test_an_update_rewrites_only_what_fails(project):
    golden = project / "goldens" / "test_it" / "noise" / "a.exr"
    before = golden.read_bytes()
    assert passes(project, "--golden-update", expression="image + np.float32(9e-5)") is None
    assert golden.read_bytes() == before


NODES = """
import numpy as np
import pytest

class TestLens:
    @pytest.mark.parametrize("side", [8, 16])
    def test_square(self, side, golden):
        golden.check(np.full((side, side), 0.5, np.float32))

def test_named(golden):
    golden.check(np.full((8, 8), 0.25, np.float32), "named")
"""


def test_a_golden_has_the_name_of_its_node(tmp_path):
    (tmp_path / "test_it.py").write_text(NODES)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    assert ran(tmp_path, "--golden-update")[0] == 0
    folder = tmp_path / "goldens" / "test_it"
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*.exr")}
    nodes = {"TestLens/test_square[8].exr", "TestLens/test_square[16].exr"}
    assert found == nodes | {"named.exr"}


def test_a_missing_golden_is_a_line_without_a_traceback(tmp_path):
    (tmp_path / "test_it.py").write_text(NODES)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    lines = ran(tmp_path)[1].splitlines()
    told = next(line for line in lines if "named.exr" in line)
    assert "there is no such golden; make it with pytest --golden-update" in told
    assert not any(line.startswith((">", "E ")) for line in lines)


@pytest.mark.parametrize("options", [(), ("--golden-update",), XDIST, (*XDIST, "--golden-update")])
def test_two_tests_of_one_golden_are_refused(options, project):
    twin = 'image, "noise/a")\n\ndef test_another(golden):\n    golden.check(image'
    said = str(passes(project, *options, expression=twin))
    assert said.count("too; give one of both another name") >= 1
    assert "is the golden of test_it.py::test_a" in said


def test_small_values_are_judged_by_their_own_scale(project):
    assert passes(project, "--golden-update", expression="image * np.float32(8e-5)") is None
    assert passes(project, expression="image * np.float32(8e-5)") is None
    assert "empty" in str(passes(project, expression="image * 0"))
    assert "fails max>8e-09" in str(passes(project, expression="image * np.float32(4e-5)"))
