"""Acceptance of pictures: files of B are copied to A, with the recipes of their samples."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from defocus_core.compare.pairing import RECIPE, Recipe, read_recipes
from defocus_core.compare.picture import planes_of, read_picture
from defocus_core.compare.record import EXTRA, Comparison
from defocus_core.errors import InputError, reason
from defocus_core.io.exr.writing import write_exr
from defocus_core.io.write_files import (
    GOLDEN,
    Folder,
    left_in,
    require_replaceable,
    unwritable,
    written_together,
    written_whole,
)


def accept_picture(folder: Path, golden: Path, picture: Any) -> None:
    """Write a picture to the path `golden`, which lies below `folder`.

    `picture`: the path of a file, which is copied; or an array or a tensor, written as EXR.
    """
    is_file = isinstance(picture, str | Path)
    planes = {} if is_file else planes_of(picture)
    with written_together(folder):
        if is_file:
            read_picture(Path(picture))  # what cannot be read is not accepted
            with written_whole(golden) as file:
                file.write(Path(picture).read_bytes())
        else:
            write_exr(golden, planes, {})


def accept_files(
    a: Path, b: Path, records: Sequence[Comparison], samples: Mapping[str, Recipe]
) -> list[Path]:
    """Copy the files of B that differ from those of A, or that A lacks, to A; return the new paths.

    Either all files and the recipes of their samples appear, or none. Files of A that B lacks stay,
    unless B has them under another name. Files that cannot be read are not copied.
    """
    pairs, renamed = [], []
    for record in records:
        if record.acceptable and record.b is not None:
            if record.status == EXTRA:  # a link may lead anywhere
                read_picture(record.b)
            target = record.a or a / record.b.relative_to(b)
            if record.a is not None and record.renamed:
                target = a / record.b.relative_to(b)
                renamed.append(record.a.relative_to(a).as_posix())
            # A batch may have it in another format: A gets the file of B, under the name of B.
            target = target.with_suffix(record.b.suffix)
            if target != record.a:
                require_replaceable(target, GOLDEN)
            pairs.append((record.b, target))
    try:
        for path in (*(target for _, target in pairs), *(a / f"{n}{RECIPE}" for n in samples)):
            if path.is_relative_to(a):
                Folder(a).path(path.relative_to(a).as_posix())  # refused before any is replaced
    except OSError as error:
        raise unwritable(a, error) from error
    with written_together(a if a.is_dir() or not a.exists() else None):
        for source, target in pairs:
            try:
                with source.open("rb") as old, written_whole(target) as new:
                    shutil.copyfileobj(old, new)
            except OSError as error:
                problem = f"cannot be read: {reason(error)}"
                raise InputError(
                    "unreadable", problem, "check its permissions", path=source
                ) from None
        for name, sample in samples.items():
            with written_whole(a / f"{name}{RECIPE}") as file:
                file.write(sample.json)
    for name in renamed:
        Folder(a).remove(name)
    for name, sample in read_recipes(a).items() if renamed else ():
        if not any((a / file).exists() for file in sample.files.values()):
            Folder(a).remove(f"{name}{RECIPE}")
    for folder in {target.parent for _, target in pairs}:
        for name in left_in(folder):
            Folder(folder).remove(name)
    return [target for _, target in pairs]
