"""What the README and the help topics show is what happens: their commands run."""

import re
import runpy
import shlex
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import color_exr, depth_exr, ramp, run, succeed, texture, write_exr
from deep_files import write_deep_samples
from depth_files import png
from elements import disc, element, write

from defocus_cli.commands.help import TOPICS
from defocus_core import batch_jobs, read_color

ROOT = Path(__file__).parents[1]
HELP = ROOT / "defocus_cli" / "help"
DOCUMENTS = {"README": ROOT / "README.md"} | {name: HELP / f"{name}.md" for name in TOPICS}
CONTRIBUTING = ROOT / ".github" / "CONTRIBUTING.md"
SCENES = [path.parent.name for path in (ROOT / "sample_scenes").glob("*/rgb.exr")]
# Commands of other programs, which need a network, a cluster or minutes.
ELSEWHERE = {"make", "pip"}
# Tests of their own run these; here only their options are parsed.
PARSED = {"bench", "verify"}
IN_THIS_PROCESS = {"batch": ["--processes", "1"]}


def commands(text):
    """The indented lines of a document that call a program, as words."""
    lines = re.findall(r"^    (.+)$", text.replace("\\\n", ""), re.M)
    found = (line for line in lines if re.match(r"(defocus|python|make|pip|sbatch)\b", line))
    return [shlex.split(line, comments=True) for line in found]


def blocks(text):
    """Type and content of the fenced blocks of a document."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", text, re.M | re.S)


def write_named_blocks(text, folder):
    """Write each block whose first line is the name of a file."""
    for _, content in blocks(text):
        named = re.match(r"# (\w+\.\w+)\n", content)
        if named:
            (folder / named[1]).write_text(content)


@pytest.fixture
def desk(tmp_path, here):
    """The working directory, with tiny files of all the names that the documents use."""
    for path in (*(Path("sample_scenes", name) for name in SCENES), Path()):
        color_exr(tmp_path / path / "rgb.exr")
        depth_exr(tmp_path / path / "depth.exr")
    shutil.copy(ROOT / "sample_scenes" / "training.py", tmp_path / "sample_scenes")
    color, depth = texture(), ramp()
    color_exr(tmp_path / "behind.exr", color)
    depth_exr(tmp_path / "z.exr", depth + 4)
    planes = {name: color[..., i] for i, name in enumerate("RGB")}
    write_exr(tmp_path / "scene.exr", Z=depth, **planes)
    ball = element(disc())
    both_views = ball | {f"left.{channel}": plane for channel, plane in ball.items()}
    write(tmp_path / "ball.exr", both_views, multiView=["right", "left"])
    for number, name in enumerate(("hair", "body")):
        sample = {"R": 0.1, "G": 0.2, "B": 0.1, "A": 0.5, "Z": 1.5 + number}
        write_deep_samples(tmp_path / f"{name}_deep.exr", [[[sample] * 2] * 16] * 12)
    for frame in range(1001, 1004):
        write_exr(tmp_path / f"shot.{frame}.exr", **planes)
        depth_exr(tmp_path / f"depth.{frame}.exr", depth)
    color_exr(tmp_path / "frames" / "a.exr")
    depth_exr(tmp_path / "depths" / "a.exr")
    numbers = np.round(depth * 256)
    numbers[0, 0] = 0  # a hole
    png(tmp_path / "kitti.png", numbers)
    disparity = np.tile(np.linspace(0, 1, 320, dtype=np.float32)[None, :, None], (240, 1, 1))
    names = {"disparity.png": disparity, "matte.png": disparity, "photo.jpg": texture(320, 240)}
    for name, pixels in names.items():
        picture = oiio.ImageBuf(oiio.ImageSpec(320, 240, pixels.shape[2], oiio.UINT8))
        picture.set_pixels(oiio.ROI(), pixels)
        assert picture.write(str(tmp_path / name))
    write_named_blocks(DOCUMENTS["conventions"].read_text(), tmp_path)  # the lens file
    return tmp_path


def carry_out(words):
    """Run a command of a document, or as much of it as a test can."""
    program, *rest = words
    if program in ELSEWHERE or "--scheduler" in rest:
        return
    if program == "sbatch":
        wrapped = rest[rest.index("--wrap") + 1].replace("$SLURM_ARRAY_TASK_ID", "1")
        carry_out(shlex.split(wrapped))
        return
    if program == "python":
        runpy.run_path(rest[0])
        return
    extra = ["--help"] if rest[0] in PARSED else IN_THIS_PROCESS.get(rest[0], [])
    succeed(*rest, *extra)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_commands_of_a_document_run_one_after_another(name, desk):
    text = DOCUMENTS[name].read_text().replace("n = 32", "n = 2")
    write_named_blocks(text, desk)
    for words in commands(text):
        carry_out(words)


def test_a_set_to_train_on_takes_a_dozen_lines():
    text = DOCUMENTS["python"].read_text()
    training = text[text.index("## Training") : text.index("`RandomDefocus` draws new")]
    (jobs, script), words = (content.splitlines() for _, content in blocks(training)), training
    scenes = [folder for folder in SCENES if (ROOT / "sample_scenes" / folder).is_dir()]
    assert 32 * len(scenes) == 160
    assert "n = 32" in training
    assert len(jobs) + len(commands(words)) <= 12
    assert len([line for line in script if line]) <= 12


@pytest.mark.parametrize("name", ["README", "python", "look", "fit"])
def test_the_python_of_a_document_runs(name, desk, capsys):
    write_named_blocks(DOCUMENTS["batch"].read_text(), desk)
    assert run("batch", "jobs.toml", "-o", "out/set", "--limit", "1", "--processes", "1").code == 0
    text = DOCUMENTS[name].read_text().replace("crop=64", "crop=8")
    text = text.replace("64, 64", "8, 8").replace("n = 32", "n = 2")
    write_named_blocks(text, desk)
    names: dict[str, object] = {}
    for kind, content in blocks(text):
        if "BatchDataset" in content:
            words = ("--processes", "1", "--shards-size", "1GB")
            assert run("batch", "pairs.toml", "-o", "out/pairs", *words).code == 0
        libraries = re.findall(r"^(?:import|from) (\w+)", content, re.M)
        if kind == "python" and all(map(find_spec, libraries)):
            exec(content, names)
    if name == "fit":
        found = names["found"]
        assert (found.strength, found.focus) == pytest.approx((9.0, 0.4), rel=0.01)
        return
    if name == "look":
        assert names["views"].left.shape == names["image"].shape
        return
    if name == "README":
        written = read_color("out/python/left/rgb.exr").pixels
        assert np.abs(written - names["views"].left).max() < 1e-3
        return
    assert names["defocused"].shape == names["image"].shape
    assert names["left"].shape == names["image"].shape
    assert names["drawn"].signed_radius.shape == names["seen"].shape
    assert names["lenses"].signed_radius.abs().max() <= 20.001
    assert (names["summary"].skipped, names["summary"].statuses["ok"]) == (1, 2)
    assert {job.lens.foc_dist for job in names["jobs"]} == {1500.0}
    printed = capsys.readouterr().out
    assert str(names["sample"].files["render"]) in printed
    assert "KITTI" in printed or "kitti" in printed
    assert "disparity.png" in printed


def test_the_jobs_file_makes_as_many_pictures_as_it_says(desk):
    text = DOCUMENTS["batch"].read_text()
    write_named_blocks(text, desk)
    jobs = batch_jobs(desk / "jobs.toml", desk / "out")
    assert f"makes {len(jobs)} pictures" in text


@pytest.mark.parametrize("name", DOCUMENTS)
def test_files_that_a_document_links_to_exist(name):
    document = DOCUMENTS[name]
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", document.read_text())
    assert all((document.parent / link).is_file() for link in links)


def test_every_topic_is_linked_and_described_in_the_readme():
    readme = DOCUMENTS["README"].read_text()
    for name, subject in TOPICS.items():
        assert f"- [{name}](defocus_cli/help/{name}.md): {subject}\n" in readme
    assert {path.stem for path in HELP.iterdir()} == set(TOPICS)


def test_all_who_tell_the_version_tell_the_same():
    told = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.M)[1]
    cited = (ROOT / ".github" / "CITATION.cff").read_text()
    assert f"\nversion: {told}\n" in cited
    assert f"version = {{{told}}}" in DOCUMENTS["cite"].read_text()
    assert f"\n## {told}\n" in (ROOT / ".github" / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("name", TOPICS)
def test_a_topic_is_printed_as_it_is(name):
    assert run("help", name).out == DOCUMENTS[name].read_text()


def test_help_lists_the_topics():
    listed = run("help").out.splitlines()
    assert [line.split()[0] for line in listed] == list(TOPICS)


def test_contributing_names_files_that_are_there():
    known = {
        path.name for folder in ("defocus_core", "tests") for path in (ROOT / folder).rglob("*.py")
    }
    for name in re.findall(r"`([\w/.]+)`", CONTRIBUTING.read_text()):
        if "/" in name:
            assert any((ROOT / base / name).exists() for base in ("", "defocus_core")), name
        elif name.endswith(".py"):
            assert name in known, name


def test_the_tree_of_contributing_has_each_folder():
    text = CONTRIBUTING.read_text()
    for folder in (ROOT / "defocus_cli", ROOT / "defocus_core", ROOT / "defocus_core" / "batch"):
        for path in folder.iterdir():
            if path.is_dir() and path.name != "__pycache__":
                assert re.search(rf"^ +{path.name}/ ", text, re.M), path


def test_the_readme_is_for_the_first_five_minutes():
    assert len(DOCUMENTS["README"].read_text().splitlines()) <= 150
