"""The fixture ``golden`` of other projects: their tests run in a session of their own."""

import contextlib
import io
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


def test_what_is_not_fails_with_its_cause(project):
    said = str(passes(project, expression=SHIFTED))
    assert "noise/a: DIFFERENT: shifted by (1, 0)" in said
    assert "fails max>1e-4" in said
    assert "lets it pass" not in said  # its cause is known
    assert "--golden-update makes it the golden" in said
    assert passes(project, "--golden-update", expression=SHIFTED) is None
    assert passes(project, expression=SHIFTED) is None


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


@pytest.mark.parametrize("options", [(), ("--golden-update",), XDIST, (*XDIST, "--golden-update")])
def test_two_tests_of_one_golden_are_refused(options, project):
    twin = 'image, "noise/a")\n\ndef test_another(golden):\n    golden.check(image'
    said = str(passes(project, *options, expression=twin))
    assert said.count("too; give one of both another name") >= 1
    assert "is the golden of test_it.py::test_a" in said
