"""What the README shows is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_line import run

from defocus_cli.jobs.job import Machine, Outputs
from defocus_cli.jobs.jobs_file import read_jobs

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def block(first_line: str) -> str:
    found = re.search(rf"```\w+\n({re.escape(first_line)}\n.*?)```", README, re.S)
    assert found, first_line
    return found[1]


@pytest.fixture
def jobs_file(tmp_path: Path) -> Path:
    (tmp_path / "sample_scenes").symlink_to(ROOT / "sample_scenes")
    path = tmp_path / "jobs.toml"
    path.write_text(block("# jobs.toml"))
    return path


def test_the_jobs_file_makes_as_many_pictures_as_it_says(jobs_file: Path) -> None:
    jobs = read_jobs(jobs_file, Outputs(jobs_file.parent / "out"), Machine())
    assert f"makes {len(jobs)} pictures" in README
    assert all(path.exists() for job in jobs for path in (job.picture.color, job.picture.depth))


def test_its_lines_run_one_after_another(jobs_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(jobs_file.parent)
    command = re.search(r"^    defocus (batch jobs.toml .*)$", README, re.M)
    assert command
    ran = run(*command[1].split(), "--limit", "1", "--processes", "1", "--shards-size", "1GB")
    assert ran.code == 0, ran.err
    assert Path("out/set/shards/samples-000000.tar").exists()

    printed: list[tuple[object, ...]] = []
    names = {"print": lambda *words: printed.append(words)}
    exec(block("import torch"), names)
    exec(block("from defocus_cli.dataset.finished import samples"), names)
    assert names["seen"].render.shape == names["image"].shape
    assert names["lenses"].signed_radius.abs().max() <= 20.001
    assert [words[0].exists() for words in printed] == [True]
