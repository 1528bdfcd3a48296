"""Access to files below a folder that refuses links.

The folder itself may be a link, as the user named it. Names of files below it may come from
untrusted files; `path_fault` says what is wrong with such a name.
"""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_HOLLOW, _FILLED = 2**30, 64  # of a file of more bytes one of so many must be on the disk


def path_fault(name: object) -> str | None:
    """What is wrong with a name below a folder, as ``leads upwards``; None if nothing is."""
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


def open_plain(path: Path) -> BinaryIO:
    """Open a regular file that the user named, links followed; never waits for a pipe's writer."""
    return os.fdopen(_open(path, os.O_RDONLY), "rb")


def read_plain(path: Path, maximum: int = 2**24) -> bytes:
    """The bytes of a small regular file that the user named."""
    with open_plain(path) as file:
        data = file.read(maximum + 1)
    if len(data) > maximum:
        raise OSError(errno.EFBIG, f"has more than {maximum / 10**6:.0f} MB")
    return data


@dataclass(frozen=True)
class Folder:
    """A folder, and the files below it by their names relative to it, with slashes.

    All methods raise OSError: ELOOP where a link is in the way, EINVAL for a name of which
    `path_fault` tells.
    """

    root: Path

    def path(self, name: str, *, make: bool = False) -> Path:
        """The path of a file: a regular file, or nothing, is there.

        `make`: whether the folders that it lies in are made.
        """
        place = self._place(name, make=make)
        with suppress(FileNotFoundError):
            _require_regular(place.lstat())
        return place

    def open(self, name: str) -> BinaryIO:
        """Open a regular file for reading."""
        return open_plain(self.path(name))

    def append(self, name: str) -> int:
        """A handle that appends to a regular file, which is made if it is missing."""
        number = _open(self.path(name, make=True), os.O_RDWR | os.O_CREAT | os.O_APPEND)
        if os.fstat(number).st_nlink > 1:  # a hard link, whose other name may lie anywhere
            os.close(number)
            raise OSError(errno.EMLINK, "it has a second name, a hard link")
        return number

    def read(self, name: str) -> bytes:
        """The bytes of a regular file."""
        with self.open(name) as file:
            return file.read()

    def remove(self, name: str) -> None:
        """Remove a file or a link, but not what it leads to; nothing happens if it is missing."""
        self._place(name).unlink(missing_ok=True)

    def names(self, name: str = "") -> list[str]:
        """The names of what lies in a folder below this one, sorted; none if it is missing."""
        folder = self._place(f"{name}/*").parent if name else self.root
        return sorted(os.listdir(folder)) if folder.exists() else []  # noqa: PTH208 - names

    def create(self, name: str) -> BinaryIO:
        """Open a new file to write and read; makes its folders, replaces a file of its name."""
        place = self._place(name, make=True)
        place.unlink(missing_ok=True)
        return place.open("x+b")

    def link(self, source: Path, name: str) -> None:
        """Give a regular file another name, a new one below this folder."""
        self._place(name, make=True).hardlink_to(source.resolve())

    def rename(self, name: str, last: str) -> None:
        """Rename a file durably within its folder; a file of the new name is replaced."""
        place = self._place(name)
        place.replace(place.with_name(last))
        sync_folder(place.parent)

    def _place(self, name: str, *, make: bool = False) -> Path:
        """The path of a name, once no folder on its way is a link."""
        if (fault := path_fault(name)) is not None:
            raise OSError(errno.EINVAL, f"{name!r:.80} {fault}")
        *folders, last = name.split("/")
        place = self.root
        if make:
            place.mkdir(parents=True, exist_ok=True)
        for folder in folders:
            place /= folder
            if place.is_symlink():
                raise _link()
            if make and not place.exists():
                place.mkdir(exist_ok=True)
                sync_folder(place.parent)
        return place / last


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable, where the system can."""
    with suppress(PermissionError):  # one that may be written may not be readable
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _open(path: Path, flags: int) -> int:
    """A handle of a regular file; to open a pipe does not wait for its other end."""
    number = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    try:
        status = os.fstat(number)
        _require_regular(status)
        if status.st_size > max(_HOLLOW, status.st_blocks * 512 * _FILLED):
            raise OSError(errno.EFBIG, f"is a hole of {status.st_size / 10**6:.0f} MB")
    except BaseException:
        os.close(number)
        raise
    return number


def _require_regular(status: os.stat_result) -> None:
    if stat.S_ISLNK(status.st_mode):
        raise _link()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is not a regular file")


def _link() -> OSError:
    return OSError(errno.ELOOP, "a symbolic link is in its way")
