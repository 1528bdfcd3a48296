"""The fixture ``golden`` of other projects: their tests run in a session of their own."""

import contextlib
import io
import re
import shutil
import sys
from pathlib import Path

import pytest
from html_reports import items, keys

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
    for bounds in (
        ", ignore_region=[(0, 0, 10, 10)]",
        ", region=(20, 0, 10, 10)",
        ", fail=['found:clipped']",
        ", thresholds='loose.toml'",
    ):
        (project / "loose.toml").write_text("fail = 'max>0.5'")
        assert passes(project, expression=patch, bounds=bounds) is None, bounds
    said = passes(project, expression=SHIFTED, bounds=", max=2, fail=['found:shifted']")
    assert "fails found:shifted" in str(said)


def test_bounds_decide(project):
    dimmed = "image * np.float32(0.99)"
    assert "another exposure: x 0.99" in str(passes(project, expression=dimmed))
    assert passes(project, expression=dimmed, bounds=", psnr=40, rel_rmse=0.02") is None
    assert "fails p99.9>0.001" in str(passes(project, expression=dimmed, bounds=", p999=1e-3"))
    assert "got brightness" in str(passes(project, bounds=", brightness=1"))


@pytest.mark.parametrize("processes", [(), ("-p", "xdist", "-n", "2")])
def test_a_report_of_all_checks_lies_beside_the_junit_file(processes, project):
    said = str(passes(project, "--junitxml", "out/junit.xml", *processes, expression=SHIFTED))
    file = project / "out" / "junit.goldens.html"
    assert f"report of goldens: {Path('out', file.name)}" in said
    (shown,) = items(file)
    assert shown["name"] == "goldens/test_it/noise/a.exr"
    assert shown["words"] == "shifted by (1, 0)"
    assert keys(shown, valued=True)[:2] == ["a", "b"]
    accept = dict(shown["commands"])["Accept as the golden"]
    assert accept == "pytest test_it.py::test_a_picture --golden-update"
    assert passes(project, "--junitxml", "out/junit.xml") is None
    assert [each["status"] for each in items(file)] == ["same"]


def test_a_picture_without_a_golden_is_in_the_report(project):
    (project / "goldens" / "test_it" / "noise" / "a.exr").unlink()
    assert passes(project, "--junitxml", "junit.xml")
    (shown,) = items(project / "junit.goldens.html")
    assert (shown["status"], keys(shown)) == ("extra", ["b"])


def test_a_golden_that_is_a_pointer_of_git_lfs_is_named_as_that(project):
    golden = project / "goldens" / "test_it" / "noise" / "a.exr"
    golden.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    said = str(passes(project))
    assert "is a Git LFS pointer, not the file that it stands for; run: git lfs pull" in said
    assert "Traceback" not in said
    assert "InputError" not in said


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


def said_by(folder, *options):
    """The lines that name goldens."""
    return [line for line in ran(folder, *options)[1].splitlines() if "golden" in line]


@pytest.mark.parametrize("processes", [(), ("-p", "xdist", "-n", "2")])
def test_a_golden_has_the_name_of_its_node_and_those_of_no_test_are_pruned(processes, tmp_path):
    (tmp_path / "test_it.py").write_text(NODES)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    assert said_by(tmp_path, "--golden-update") == []
    folder = tmp_path / "goldens" / "test_it"
    owned = {"TestLens/test_square[8].exr", "TestLens/test_square[16].exr", "named.exr"}
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*.exr")}
    assert found == owned
    lost = [folder / "old.exr", folder.parent / "test_gone" / "a.exr"]
    for path in lost:
        path.parent.mkdir(exist_ok=True)
        shutil.copyfile(folder / "named.exr", path)
    (folder / "notes.md").touch()
    for partial in (("-k", "named"), ("test_it.py::test_named",)):
        assert said_by(tmp_path, *partial) == []
        assert "nothing is removed" in said_by(tmp_path, "--golden-prune", *partial)[-1]
    words = ": no test owns this golden"
    told = said_by(tmp_path)
    assert told == [f"{path.relative_to(tmp_path)}{words}" for path in reversed(lost)]
    outside = tmp_path / "mine.exr"
    shutil.move(lost[1], outside)
    (folder / "linked.exr").symlink_to(outside)
    assert len(said_by(tmp_path, "--golden-prune", *processes)) == 1
    assert (lost[0].exists(), outside.exists(), (folder / "notes.md").exists()) == (0, 1, 1)
    assert said_by(tmp_path) == []


def test_goldens_of_a_file_whose_tests_were_skipped_or_failed_are_not_judged(tmp_path):
    skipped = NODES.replace(
        "    golden.check(np.full((8, 8)", "    pytest.skip()\n    (np.full((8, 8)"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_it.py").write_text(NODES)
    assert said_by(tmp_path, "--golden-update") == []
    for text in (skipped, NODES.replace("0.25", "0.75")):
        (tmp_path / "test_it.py").write_text(text)
        assert not any("no test owns" in line for line in said_by(tmp_path, "--golden-prune"))
        assert (tmp_path / "goldens" / "test_it" / "named.exr").exists()


def test_a_missing_golden_is_a_line_without_a_traceback(tmp_path):
    (tmp_path / "test_it.py").write_text(NODES)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    told = [line for line in said_by(tmp_path) if "named.exr" in line]
    assert "there is no such golden; make it with pytest --golden-update" in told[0]
    assert not any(line.startswith((">", "E ")) for line in said_by(tmp_path))


def test_two_tests_of_one_name_are_refused_when_updating(project):
    twin = 'image, "noise/a")\n\ndef test_another(golden):\n    golden.check(image * 2'
    said = str(passes(project, "--golden-update", expression=twin))
    assert "is the golden of test_it.py::test_a_picture, too" in said


def test_small_values_are_judged_by_their_own_scale(project):
    assert passes(project, "--golden-update", expression="image * np.float32(8e-5)") is None
    assert passes(project, expression="image * np.float32(8e-5)") is None
    assert "empty" in str(passes(project, expression="image * 0"))
    assert "fails max>8e-09" in str(passes(project, expression="image * np.float32(4e-5)"))
