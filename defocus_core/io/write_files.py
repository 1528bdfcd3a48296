"""Files written completely or not at all, and the folders below which they lie.

A folder may itself be a link, as the user named it, but no link below it is followed. Names of
files below it may come from untrusted files; `path_fault` says what is wrong with such a name. In a
user's folder, only files that a run of defocus wrote may be replaced, and never an input of the
run.
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from defocus_core.errors import InputError, reason
from defocus_core.io.read_files import open_plain, opened_plain, require_regular, through_link

LEFTOVER = re.compile(r"\..+\.(\d+)\.\d+\.tmp")  # name of a sibling, with the number of its process
_serial = itertools.count()


def path_fault(name: object) -> str | None:
    """The fault of a name below a folder in words, like ``leads upwards``; None if it has none."""
    try:
        is_name = isinstance(name, str) and bool(os.fsencode(name)) and "\0" not in name
    except UnicodeEncodeError:
        is_name = False
    if not isinstance(name, str) or not is_name:
        return "is not a name of a file"
    if name.startswith("/"):
        return "is an absolute path"
    parts = name.split("/")
    if ".." in parts:
        return "leads upwards"
    return "has an empty part" if "" in parts or "." in parts else None


@dataclass(frozen=True)
class Folder:
    """A folder, and the files below it by their names relative to it, with slashes.

    All methods raise OSError: ELOOP if a link is in the way, EINVAL for a name with a `path_fault`.
    """

    root: Path

    def path(self, name: str, *, make: bool = False) -> Path:
        """The path of a name that is a regular file or missing; `make`: whether to make folders."""
        place = self._place(name, make=make)
        with suppress(FileNotFoundError):
            require_regular(place.lstat())
        return place

    def open(self, name: str) -> BinaryIO:
        """Open a regular file for reading."""
        return open_plain(self.path(name))

    def append(self, name: str) -> int:
        """The descriptor of a regular file, open for appending; a missing file is created."""
        number = opened_plain(self.path(name, make=True), os.O_RDWR | os.O_CREAT | os.O_APPEND)
        if os.fstat(number).st_nlink > 1:  # a hard link, whose other name may lie anywhere
            os.close(number)
            raise OSError(errno.EMLINK, "it has a second name, a hard link")
        return number

    def read(self, name: str) -> bytes:
        """The bytes of a regular file."""
        with self.open(name) as file:
            return file.read()

    def remove(self, name: str) -> None:
        """Remove a file, or a link without its target; a missing file is no error."""
        self._place(name).unlink(missing_ok=True)

    def names(self, name: str = "") -> list[str]:
        """The sorted names of the entries of a folder below this one; empty if it is missing."""
        folder = self._place(f"{name}/*").parent if name else self.root
        return sorted(os.listdir(folder)) if folder.exists() else []  # noqa: PTH208 - names

    def create(self, name: str) -> BinaryIO:
        """Open a new file for writing and reading; folders are made, an old file is replaced."""
        place = self._place(name, make=True)
        place.unlink(missing_ok=True)
        return place.open("x+b")

    def link(self, source: Path, name: str) -> None:
        """Make a hard link to a regular file, under a new name below this folder."""
        self._place(name, make=True).hardlink_to(source.resolve())

    def rename(self, name: str, last: str) -> None:
        """Rename a file within its folder and flush this to disk; an old file is replaced."""
        place = self._place(name)
        place.replace(place.with_name(last))
        sync_folder(place.parent)

    def _place(self, name: str, *, make: bool = False) -> Path:
        """The path of a name, after a check that no folder on the way to it is a link."""
        if (fault := path_fault(name)) is not None:
            raise OSError(errno.EINVAL, f"{name!r:.80} {fault}")
        *folders, last = name.split("/")
        place = self.root
        if make:
            place.mkdir(parents=True, exist_ok=True)
        for folder in folders:
            place /= folder
            if place.is_symlink():
                raise through_link()
            if make and not place.exists():
                place.mkdir(exist_ok=True)
                sync_folder(place.parent)
        return place / last


def sync_folder(folder: Path) -> None:
    """Flush the names in a folder to disk, where the system can."""
    with suppress(PermissionError):  # a folder that may be written may not be readable
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


class _Sibling(NamedTuple):
    """A hidden file that will replace another file of its folder."""

    folder: Folder
    name: str  # below the folder
    path: Path  # the output that the sibling becomes

    @classmethod
    def create(cls, path: Path, root: Path | None) -> _Sibling:
        """A new sibling of `path`; `root`: a folder above both files, None for their own folder."""
        root = root or path.parent
        name = path.with_name(f"{_leftover(path)}{os.getpid()}.{next(_serial)}.tmp")
        return cls(Folder(root), name.relative_to(root).as_posix(), path)

    def discard(self) -> None:
        """Remove the sibling, unless it has become its output."""
        with suppress(OSError):
            self.folder.remove(self.name)


# The files of the innermost `written_together`, and the folder below which they lie, where no link
# is followed; None if the user named the folder of each file.
_together: ContextVar[tuple[list[_Sibling], Path | None] | None] = ContextVar(
    "together", default=None
)


@contextmanager
def written_together(root: Path | None = None) -> Iterator[None]:
    """Let the files that are `written_whole` in the block appear together at its end, or none."""
    files: list[_Sibling] = []
    token = _together.set((files, root))
    try:
        yield
        for folder, name, path in files:
            try:
                folder.rename(name, path.name)
            except OSError as error:
                raise unwritable(path, error) from error
    finally:
        for sibling in files:
            sibling.discard()
        _together.reset(token)


@contextmanager
def written_whole(path: Path, root: Path | None = None) -> Iterator[BinaryIO]:
    """Open a hidden sibling of ``path`` for writing; it becomes ``path`` when the block ends well.

    Folders are made. If anything fails, the sibling is removed and an existing ``path`` is
    untouched. Siblings that killed processes left are removed, except within `written_together`.
    """
    together = _together.get()
    if together is None:
        with written_together(root), written_whole(path) as file:
            yield file
        with suppress(OSError):
            for name in left_in(path.parent):
                if name.startswith(_leftover(path)):
                    Folder(path.parent).remove(name)
        return
    sibling = _Sibling.create(path, root or together[1])
    try:
        with sibling.folder.create(sibling.name) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
    except BaseException as error:
        sibling.discard()
        if isinstance(error, OSError):
            raise unwritable(path, error) from error
        raise
    together[0].append(sibling)


def link_or_copy(source: Path, path: Path) -> None:
    """Put a file of `written_together` at a second path: as a hard link, or else as a copy."""
    together = _together.get()
    assert together is not None
    sibling = _Sibling.create(path, together[1])
    try:
        sibling.folder.link(source, sibling.name)
        together[0].append(sibling)
    except OSError:
        with written_whole(path) as copy, open_plain(source) as file:
            shutil.copyfileobj(file, copy)


def _leftover(path: Path) -> str:
    """The prefix of the names of the siblings of ``path``; the process number follows."""
    return f".{path.name[:48]}."


def left_in(folder: Path) -> Iterator[str]:
    """Yield the names of unfinished files in a folder that no other process here still writes."""
    with suppress(OSError):
        for name in Folder(folder).names():
            process = LEFTOVER.fullmatch(name)
            if process and not _runs(int(process[1])):
                yield name


def _runs(process: int) -> bool:
    """Whether another process of this number runs on this machine."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # it is another user's
        return True
    return process not in (0, os.getpid())


def is_at(path: Path, number: int) -> bool:
    """Whether the open file of descriptor `number` is still the file at `path`."""
    with suppress(FileNotFoundError, NotADirectoryError):
        return os.path.samestat(os.fstat(number), path.stat())
    return False


def unwritable(path: Path, error: OSError) -> InputError:
    """The InputError for an output that the system refused."""
    room = "free some space or name another output directory"
    remedies = {
        **{errno.ENOSPC: room, errno.EDQUOT: room},
        errno.EFBIG: "allow larger files, as 'ulimit -f unlimited' does",
        errno.EISDIR: "it is a directory; name another output",
        errno.ELOOP: "put a directory or a file there, or name another output directory",
    }
    remedy = remedies.get(error.errno or 0, "name an output directory you may write to")
    return InputError("unwritable", f"cannot be written: {reason(error)}", remedy, path=path)


KIND = "defocus:kind"  # the attribute of a picture that says what it is
CONTACT, DIFFERENCE, GOLDEN = "contact sheet", "difference image", "golden"
_HEAD = 2**16  # bytes


def _picture(kind: str) -> re.Pattern[bytes]:
    """The pattern of the first bytes of a PNG or EXR with an attribute that names a kind."""
    return re.compile(rf"(?:\x89PNG|v/1\x01).*{KIND}\0.{{0,16}}{kind}".encode("latin-1"), re.S)


# Patterns of the first bytes of files that defocus writes, by kind.
_BEGINNINGS = {
    "html": re.compile(
        rb"<!doctype html>.*default-src 'none'; img-src data:; style-src 'sha256-", re.S
    ),
    "markdown": re.compile(b"<!-- defocus compare -->\n"),
    "junit": re.compile(
        rb"<\?xml version='1.0' encoding='utf-8'\?>.*<testsuite name=\"defocus compare\"", re.S
    ),
    CONTACT: _picture(CONTACT),
    DIFFERENCE: _picture(DIFFERENCE),
    GOLDEN: re.compile(b"(?!)"),  # matches nothing: pairs and recipes decide
}


def require_replaceable(
    path: Path,
    kind: str = "",
    *,
    overwrite: bool = False,
    inputs: frozenset[tuple[int, int]] = frozenset(),
) -> None:
    """Refuse to replace a file or folder that must be kept.

    `kind`: a key of `_BEGINNINGS`; a file of that kind, or an empty one, may be replaced;
    `overwrite`: whether any file may be replaced; `inputs`: the `identities` of files that are
    read, which are never replaced.
    """
    if inputs and not inputs.isdisjoint(identities([path])):
        raise replaces_input(path)
    if overwrite or not path.exists():
        return
    if not kind:
        remedy = "name another output, or add ‹overwrite›"
        raise InputError("exists", "exists already", remedy, path=path)
    try:
        with open_plain(path) as file:
            head = file.read(_HEAD)
    except IsADirectoryError:
        return  # writing it raises the error
    except OSError as error:
        problem = f"cannot be replaced: {reason(error)}"
        raise InputError("unwritable", problem, "name another file", path=path) from None
    if head and not _BEGINNINGS[kind].match(head):
        what = "report" if kind in ("html", "junit", "markdown") else kind
        problem = f"exists already, and is not a {what} that could be replaced"
        raise InputError("exists", problem, "name another file, or move it away", path=path)


def identities(paths: Iterable[Path]) -> frozenset[tuple[int, int]]:
    """The (device, inode) of each existing file, links followed."""
    found = set()
    for path in paths:
        with suppress(OSError):
            status = path.stat()
            found.add((status.st_dev, status.st_ino))
    return frozenset(found)


def replaces_input(path: Path) -> InputError:
    """The InputError for an output that is an input, too."""
    problem = "is an input and would be overwritten"
    return InputError("replaces-input", problem, "name another output", path=path)
