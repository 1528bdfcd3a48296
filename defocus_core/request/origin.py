"""The origin of a data set, such as title and licence, and the copy of the jobs file in OUT.

``OUT/jobs.toml`` is a copy of the jobs file below a comment line. A batch from Python has its
tables in ``OUT/jobs.json`` instead. The dataset card and the index take title, licence, source and
citation from the table ``[dataset]`` of this copy.
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
    """Title, licence, source and citation of a data set, and the seed that shuffles its samples.

    A text is empty if it is not given; ``shuffle`` is None to keep the samples in order.
    """

    title: str = ""
    licence: str = ""
    source: str = ""
    citation: str = ""
    shuffle: int | None = None

    @property
    def said(self) -> dict[str, str]:
        """The texts that are not empty, by field name."""
        return {key: text for key in _TEXTS if (text := getattr(self, key))}


KEYS = tuple(asdict(Origin()))
_TEXTS = KEYS[:-1]


def read_origin(table: Table) -> Origin:
    """Read the table ``[dataset]`` of a jobs file."""
    table.refuse_unknown(KEYS)
    texts = {key: text for key in _TEXTS if (text := table.text(key)) is not None}
    return Origin(**texts, shuffle=table.parsed("shuffle", whole))


@dataclass(frozen=True)
class JobsSource:
    """The bytes of a jobs file; or the tables of a batch from Python, as JSON."""

    path: Path | None  # the jobs file; None for tables from Python
    data: bytes


def keep(out: Path, source: JobsSource) -> bool:
    """Copy the jobs file or tables of a batch to OUT; True if a file was written.

    Nothing is written if the copy is up to date, or if another program wrote a file of this name.
    """
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
            note(f"{out / name}: was not written by this batch and is kept; no jobs file is copied")
    elif before != data:
        with written_whole(out / name, out) as file:
            file.write(data)
        return True
    return False


def origin_of(out: Path) -> Origin:
    """The origin in the copy of the jobs file in OUT; an empty one if there is none."""
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
