"""Files below a folder, reached from it by directory handles: no link below it is ever followed.

The folder itself may be a link: its user named it. What lies below may come from anywhere, as names
do that a file holds; `path_fault` says what is wrong with such a name.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_HOLLOW, _FILLED = 2**30, 64  # of a file of more bytes one of so many must be on the disk
_DIRECTORY = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def path_fault(name: object) -> str | None:
    """What is wrong with a name below a folder, as ``leads upwards``; None if nothing is."""
    if not isinstance(name, str) or not name or "\0" in name or not _is_encodable(name):
        return "is not a name of a file"
    if name.startswith("/"):
        return "is an absolute path"
    parts = name.split("/")
    if ".." in parts:
        return "leads upwards"
    return "has an empty part" if "" in parts or "." in parts else None


def _is_encodable(name: str) -> bool:
    with suppress(UnicodeEncodeError):
        return bool(os.fsencode(name))
    return False


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

    def open(self, name: str) -> BinaryIO:
        """Open a regular file for reading."""
        with self._parent(name) as (folder, last):
            return os.fdopen(_open(last, os.O_RDONLY | os.O_NOFOLLOW, folder), "rb")

    def append(self, name: str) -> int:
        """A handle that appends to a regular file, which is made if it is missing."""
        with self._parent(name, make=True) as (folder, last):
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
            number = _open(last, flags, folder)
        if os.fstat(number).st_nlink > 1:  # a hard link, whose other name may lie anywhere
            os.close(number)
            raise OSError(errno.EMLINK, "it has a second name, a hard link")
        return number

    def read(self, name: str) -> bytes:
        """The bytes of a regular file."""
        with self.open(name) as file:
            return file.read()

    def status(self, name: str) -> os.stat_result | None:
        """The status of what is there, be it a link; None if nothing is."""
        with suppress(FileNotFoundError), self._parent(name) as (folder, last):
            return os.stat(last, dir_fd=folder, follow_symlinks=False)
        return None

    def path(self, name: str) -> Path:
        """The path of a file, for those who read by paths: a regular file, or nothing, is there."""
        status = self.status(name)
        if status is not None:
            _require_regular(status)
        return self.root / name

    def remove(self, name: str) -> None:
        """Remove a file or a link, but not what it leads to; nothing happens if it is missing."""
        with suppress(FileNotFoundError), self._parent(name) as (folder, last):
            os.unlink(last, dir_fd=folder)

    def names(self, name: str = "") -> list[str]:
        """The names of what lies in a folder below this one, sorted; none if it is missing."""
        if name:
            _require_name(name)
        with suppress(FileNotFoundError), self._entered(name.split("/") if name else ()) as number:
            return sorted(os.listdir(number))  # noqa: PTH208 - by its handle
        return []

    def create(self, name: str) -> BinaryIO:
        """Open a new file for writing and reading; folders are made, what has its name goes."""
        with self._parent(name, make=True) as (folder, last):
            with suppress(FileNotFoundError):
                os.unlink(last, dir_fd=folder)
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            return os.fdopen(os.open(last, flags, 0o666, dir_fd=folder), "w+b")

    def rename(self, name: str, last: str) -> None:
        """Give a file another name in its folder, that of a file that it replaces; durable."""
        with self._parent(name) as (folder, old):
            os.replace(old, last, src_dir_fd=folder, dst_dir_fd=folder)
            sync_names(folder)

    @contextmanager
    def _parent(self, name: str, *, make: bool = False) -> Iterator[tuple[int, str]]:
        """A handle of the folder that a file lies in, and the name of the file in it."""
        _require_name(name)
        *folders, last = name.split("/")
        with self._entered(folders, make=make) as number:
            yield number, last

    @contextmanager
    def _entered(self, folders: Sequence[str], *, make: bool = False) -> Iterator[int]:
        """A handle of a folder below this one."""
        if make:
            self.root.mkdir(parents=True, exist_ok=True)
        number = os.open(self.root, _DIRECTORY & ~os.O_NOFOLLOW)
        try:
            for folder in folders:
                if make:
                    with suppress(FileExistsError):
                        os.mkdir(folder, dir_fd=number)
                        sync_names(number)
                inner = _inner(folder, number)
                os.close(number)
                number = inner
            yield number
        finally:
            os.close(number)


def sync_names(folder: int) -> None:
    """Make the names in an open folder durable, where its file system syncs folders."""
    with suppress(PermissionError):
        os.fsync(folder)


def _inner(name: str, folder: int) -> int:
    try:
        return os.open(name, _DIRECTORY, dir_fd=folder)
    except OSError as error:
        if stat.S_ISLNK(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
            raise _link() from error
        raise


def _open(path: str | Path, flags: int, folder: int | None = None) -> int:
    """A handle of a regular file; to open a pipe does not wait for its other end."""
    try:
        number = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.ELOOP and flags & os.O_NOFOLLOW:
            raise _link() from error
        if error.errno == errno.ENXIO:  # a pipe without a reader, or a socket
            raise OSError(errno.EINVAL, "is not a regular file") from error
        raise
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


def _require_name(name: str) -> None:
    fault = path_fault(name)
    if fault is not None:
        raise OSError(errno.EINVAL, f"{name!r:.80} {fault}")


def _link() -> OSError:
    return OSError(errno.ELOOP, "a symbolic link is in its way")
