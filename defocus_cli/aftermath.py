"""What is made of OUT when a batch has ended: the index of its samples, and shards of them."""

from __future__ import annotations

from pathlib import Path

from defocus_cli import dataset_index, tar_shards
from defocus_cli.journal import read_all
from defocus_cli.ledger import Ledger


def index(out: Path, shards_size: int | None) -> list[Path]:
    """Write the index, and tars of at most ``shards_size`` bytes if asked for.

    Returns:
        What was written.

    Raises:
        InputError: it cannot be.
    """
    records = Ledger(out, read_all(out)).live
    written = [dataset_index.write(out, records)]
    if shards_size is not None:
        written += tar_shards.write(out, records, shards_size)
    return written
