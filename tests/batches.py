"""Small batches for the tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import pair

from defocus_cli import here
from defocus_cli.batch_options import Crew

JOBS = """
[inputs]
color = "rgb/*.exr"
depth = "depth/*.exr"
[lens]
focal-length = "50mm"
fnumber = 2
[sweep]
focus = ["1.5m", "2m"]
[outputs]
kinds = ["coc"]
"""


def jobs_file(folder: Path, *stems: str, text: str = JOBS) -> Path:
    """A jobs file, and two lenses' worth of pictures beside it."""
    for stem in stems or ("a", "b"):
        pair(folder, stem)
    path = folder / "jobs.toml"
    path.write_text(text)
    return path


def records(out: Path, name: str = "journal.jsonl") -> list[dict[str, Any]]:
    lines = (out / name).read_text().splitlines()
    return [json.loads(line) for line in lines if line]


def contents(out: Path) -> dict[str, bytes]:
    """All files but journals."""
    found = {path for path in out.rglob("*") if path.is_file() and "journal" not in path.name}
    return {str(path.relative_to(out)): path.read_bytes() for path in found}


def without_times(out: Path) -> list[dict[str, Any]]:
    """The records by name, less what differs from one run to another."""
    found = []
    for record in records(out):
        for stamp in record["outputs"].values():
            stamp.pop("mtime_ns", None)
        found.append({k: v for k, v in record.items() if k not in ("seconds", "finished")})
    return sorted(found, key=lambda record: str(record["sample_id"]))


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches are computed in the process of the test, which has torch already."""
    monkeypatch.setattr(Crew, "execute", lambda crew: here.execute)
