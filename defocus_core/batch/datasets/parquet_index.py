"""The index as a table for data tools, ``OUT/samples.parquet``: a row for each sample.

It holds what ``metadata.jsonl`` holds, and once it is there it goes with it. It has a name of its
own, as Hugging Face's `datasets` refuses a folder with two files of ``metadata``. pyarrow writes
it, an extra.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

from defocus_core.batch.datasets import sample_index
from defocus_core.errors import InputError, UsageProblem, cannot_read
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import unwritable, written_whole
from defocus_core.system.text import note

NAME = "samples.parquet"
_REMEDY = "run: pip install 'defocus[parquet]'"


def require() -> None:
    """Refuse to write a table without pyarrow, before hours of rendering."""
    if find_spec("pyarrow") is None:
        problem = "needs pyarrow, which is not installed"
        raise UsageProblem("needs-extra", problem, _REMEDY, field="parquet")


def write(out: Path) -> Path:
    """Write the index of OUT as a table, whole or not at all."""
    require()
    import pyarrow as pa
    import pyarrow.parquet

    index, path = out / sample_index.NAME, out / NAME
    try:
        rows = [json.loads(line) for line in Folder(out).read(sample_index.NAME).splitlines()]
        # Of an array of rows a column is what any row has; no rows have no type of their own.
        every = pa.array(rows, type=None if rows else pa.struct([]))
    except OSError as error:
        raise cannot_read(index, error, "it is written when a batch ends") from None
    except (ValueError, TypeError, RecursionError) as error:
        problem, remedy = f"is no table: {error}", "let the batch write it again"
        raise InputError("malformed", problem, remedy, path=index) from None
    with written_whole(path, out) as file:
        pyarrow.parquet.write_table(pa.Table.from_struct_array(every), file)
    return path


def follow(out: Path) -> list[Path]:
    """Write the table of OUT again if there is one, else remove it; what is written."""
    below = Folder(out)
    try:
        if below.status(NAME) is None:
            return []
        if find_spec("pyarrow") is not None and below.status(sample_index.NAME) is not None:
            return [write(out)]
        below.remove(NAME)
    except OSError as error:
        raise unwritable(out / NAME, error) from None
    note(f"{out / NAME}: removed, as samples change; ‹parquet› writes it again")
    return []
