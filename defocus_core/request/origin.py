"""The origin of a data set: ``[dataset]`` of its jobs file, and the file itself, kept in OUT.

``OUT/jobs.toml`` is the jobs file under a line that says so, or ``OUT/jobs.json`` the tables of a
batch from Python. Card and index take title, licence, source and citation from it.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from defocus_core.io.write_files import Folder, written_whole
from defocus_core.request import toml_file
from defocus_core.request.quantities import whole
from defocus_core.request.toml_file import LARGEST_FILE, Table
from defocus_core.system.text import note

KEPT = "jobs.toml"
_KEPT_TABLES = "jobs.json"
_MARK = b"# The jobs file of this batch, kept by defocus; it is replaced by that of the next run.\n"


@dataclass(frozen=True)
class Origin:
    """Title, licence, source, citation and the seed of the order of samples, if given."""

    title: str = ""
    licence: str = ""
    source: str = ""
    citation: str = ""
    shuffle: int | None = None

    @property
    def said(self) -> dict[str, str]:
        """The given texts, by key."""
        return {key: text for key in _TEXTS if (text := getattr(self, key))}


KEYS = tuple(asdict(Origin()))
_TEXTS = KEYS[:-1]


def read_origin(table: Table) -> Origin:
    """The origin in ``[dataset]``."""
    table.refuse_unknown(KEYS)
    texts = {key: text for key in _TEXTS if (text := table.text(key)) is not None}
    return Origin(**texts, shuffle=table.parsed("shuffle", whole))


@dataclass(frozen=True)
class JobsSource:
    """The request of a batch as it was read: bytes of a jobs file, or tables as JSON."""

    path: Path | None  # the jobs file; None for tables from Python
    data: bytes


def keep(out: Path, source: JobsSource) -> bool:
    """Keep the request of a batch in OUT, without replacing foreign files; True if it is new."""
    if source.path is None:
        name, data = _KEPT_TABLES, source.data
    else:
        name, data = KEPT, _MARK + source.data.removeprefix(_MARK)
    before, tables = _kept(out, name), None
    with suppress(ValueError, RecursionError):
        tables = json.loads(before or b"")
    is_ours = isinstance(tables, dict) and "inputs" in tables
    if before is not None and not before.startswith(_MARK) and not is_ours:
        if source.path is None or source.path.resolve() != (out / KEPT).resolve():
            note(f"{out / name}: is not of this batch, and stays; what was asked for is not kept")
    elif before != data:
        with written_whole(out / name, out) as file:
            file.write(data)
        return True
    return False


def origin_of(out: Path) -> Origin:
    """The origin by the jobs file kept in OUT; an empty one without it."""
    with suppress(ValueError, TypeError, AttributeError, RecursionError):
        for name, loads in ((KEPT, toml_file.loads), (_KEPT_TABLES, json.loads)):
            if (data := _kept(out, name)) is not None:
                said = loads(data.decode()).get("dataset", {})
                texts = {key: str(said[key]) for key in _TEXTS if key in said}
                return Origin(**texts, shuffle=said.get("shuffle"))
    return Origin()


def _kept(out: Path, name: str) -> bytes | None:
    with suppress(OSError), Folder(out).open(name) as file:
        return file.read(LARGEST_FILE)
    return None
