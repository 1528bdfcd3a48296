"""Checks of files before they are decoded, and the errors of decoders.

Decoders written in C print on the stdout and stderr of the process; `quiet` discards that, so that
stdout has only data and stderr only one line for each error.
"""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar, cast

from defocus_core.errors import InputError, first_line, reason
from defocus_core.system.process import delayed_signals

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


AGAIN = "write or copy it again"
# Exceptions raised when a JSON document of any content is read as one of a known structure.
MALFORMED = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError)
MAX_PIXELS = 2**30
_HOLLOW, _FILLED = 2**30, 64  # of files larger than the first, 1 byte of 64 must be on the disk
# No codec compresses real pixels by more than MAX_RATIO; smaller images are not checked.
MAX_RATIO = 10_000
UNASKED_BYTES = 2**28
_NO_CODEC = ("support is not configured", "decoding is not implemented")  # as libtiff says it

# Messages of the system that the file is not to blame for, and their remedies.
_LACKS = {
    os.strerror(errno.EMFILE): "allow more, as 'ulimit -n 4096' does",
    os.strerror(errno.ENFILE): "close other programs",
    os.strerror(errno.ENOMEM): "free memory, or allow more",
    os.strerror(errno.EAGAIN): "allow more processes and threads, as 'ulimit -u' does",
    "can't start new thread": "allow more processes and threads, as 'ulimit -u' does",
}
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"  # git-lfs, docs/spec.md

_OfFile = TypeVar("_OfFile", bound="Callable[..., Any]")
_quiet_lock = threading.RLock()


def open_plain(path: Path) -> BinaryIO:
    """Open a regular file that the user named; follows links, and never waits at a pipe."""
    return os.fdopen(opened_plain(path, os.O_RDONLY), "rb")


def read_plain(path: Path, maximum: int = 2**24) -> bytes:
    """The bytes of a small regular file that the user named."""
    with open_plain(path) as file:
        data = file.read(maximum + 1)
    if len(data) > maximum:
        raise OSError(errno.EFBIG, f"has more than {maximum / 10**6:.0f} MB")
    return data


def opened_plain(path: Path, flags: int) -> int:
    """The descriptor of a regular file opened with `flags` of os.open, never waiting at a pipe."""
    number = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    try:
        status = os.fstat(number)
        require_regular(status)
        if status.st_size > max(_HOLLOW, status.st_blocks * 512 * _FILLED):
            raise OSError(errno.EFBIG, f"is a hole of {status.st_size / 10**6:.0f} MB")
    except BaseException:
        os.close(number)
        raise
    return number


def require_regular(status: os.stat_result) -> None:
    """Raise OSError for a link, a folder, or anything else that is not a regular file."""
    if stat.S_ISLNK(status.st_mode):
        raise through_link()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is not a regular file")


def through_link() -> OSError:
    """The OSError for a path with a symbolic link in it."""
    return OSError(errno.ELOOP, "a symbolic link is in its way")


def once(function: _OfFile) -> _OfFile:
    """Decorate a function of a file, so that its results are cached until the file changes."""
    # more than a job has files; not many more, as headers may be large
    found = lru_cache(maxsize=32)(lambda _stamp, *of: function(*of))

    @wraps(function)
    def known(path: Path, *of: Any) -> Any:
        try:
            it = path.stat()
        except (OSError, ValueError):  # the function raises its own error
            return function(path, *of)
        stamp = it.st_dev, it.st_ino, it.st_size, it.st_mtime_ns, it.st_ctime_ns, it.st_mode
        return found(stamp, path, *of)

    return cast(_OfFile, known)


def require_utf_8(path: Path | str) -> None:
    """Refuse a name that is not UTF-8, which neither journals nor decoders accept."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        remedy = "rename it"
        raise InputError("not-utf-8", "has a name that is not UTF-8", remedy, path=path) from None


@once
def read_head(path: Path, count: int = 16) -> bytes:
    """The first ``count`` bytes of a file; an InputError if it is missing, unreadable or empty."""
    require_utf_8(path)
    try:
        if path.is_dir():
            remedy = "name a file in it"
            raise InputError("wrong-type", "is a directory, not an image", remedy, path=path)
        if path.exists() and not path.is_file():  # opening a pipe would wait
            remedy = "copy what it holds to one"
            raise InputError("wrong-type", "is not a regular file", remedy, path=path)
        with open_plain(path) as file:
            head = file.read(max(count, len(_LFS_POINTER)))
    except (OSError, ValueError) as error:  # ValueError: a zero byte inside the name
        if getattr(error, "errno", None) in (errno.ENOENT, errno.ELOOP):
            raise missing(path) from error
        remedy = "check its permissions, or copy it again"
        problem = f"cannot be opened: {reason(error)}"
        other = InputError("unreadable", problem, remedy, path=path)
        raise _lacking(path, reason(error)) or other from error
    if not head:
        raise InputError("empty", "is empty (zero bytes)", AGAIN, path=path)
    if head.startswith(_LFS_POINTER):
        problem = "is a Git LFS pointer, not the file that it stands for"
        raise InputError("wrong-type", problem, "run: git lfs pull", path=path)
    return head[:count]


def is_heic(head: bytes) -> bool:
    """Whether a file that starts with ``head`` is HEIF."""
    return head[4:8] == b"ftyp" and head[8:12] in (b"heic", b"heix", b"mif1", b"msf1", b"hevc")


def is_jpeg(head: bytes) -> bool:
    """Whether a file that starts with ``head`` is a JPEG."""
    return head.startswith(b"\xff\xd8\xff")


def missing(path: Path, what: str = "file") -> InputError:
    """The InputError for a missing file, or for a link to a missing file."""
    problem, remedy = f"no such {what}", "check the name"
    if path.is_symlink():
        problem = "is a symbolic link that leads to nothing"
        remedy = "make the link anew, or name another path"
    return InputError("not-found", problem, remedy, path=path)


def check_size(path: Path, width: int, height: int, pixel_bytes: int) -> None:
    """Refuse an image whose header claims more pixels than the file can hold, before allocation.

    `pixel_bytes`: decoded bytes of a pixel.
    """
    claim = f"its header claims {width}×{height} px"
    if width < 1 or height < 1:
        raise InputError("damaged", f"is damaged: {claim}", AGAIN, path=path)
    if width * height > MAX_PIXELS:
        remedy = "cut it into smaller images"
        raise InputError("too-large", f"{claim}, more than {MAX_PIXELS}", remedy, path=path)
    size, decoded = path.stat().st_size, width * height * pixel_bytes
    if decoded > max(UNASKED_BYTES, size * MAX_RATIO):
        problem = f"{claim}, but the file has only {size} bytes"
        raise InputError("damaged", problem, AGAIN, path=path)


@contextmanager
def quiet() -> Iterator[None]:
    """Discard all that is printed during the block; only one thread at a time runs such a block.

    stdout and stderr belong to the process: what other threads print meanwhile is lost too, unless
    they print inside `spoken`.
    """
    with _quiet_lock:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        saved: list[tuple[int, int]] = []
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            for number in (1, 2):
                with suppress(OSError):  # closed by whoever started us
                    saved.append((number, os.dup(number)))
                    os.dup2(nowhere, number)
            # OpenEXR's binding prints through Python as well.
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                yield
        finally:
            for number, copy in saved:
                os.dup2(copy, number)
                os.close(copy)
            os.close(nowhere)


@contextmanager
def spoken() -> Iterator[None]:
    """Keep what the block prints from being discarded by another thread's `quiet`."""
    with _quiet_lock:
        yield


def damaged(path: Path, why: str, what: str = "is truncated or damaged") -> InputError:
    """The error for a file that cannot be decoded, unless the message `why` blames the system.

    Then it is the error for what the system lacks, such as memory. `what`: the problem in words.
    """
    return _lacking(path, why) or InputError("damaged", f"{what} ({why})", AGAIN, path=path)


def _lacking(path: Path, why: str) -> InputError | None:
    """The error for what the system lacks, such as memory; None if the message `why` names none."""
    lacks = next((words for words in _LACKS if words.lower() in why.lower()), "")
    problem = f"cannot be read: {lacks}"
    return InputError("unreadable", problem, _LACKS[lacks], path=path) if lacks else None


def needs_extra(path: Path, kind: str, library: str, extra: str) -> InputError:
    """The error for a file whose library is not installed; `extra`: the pip extra that has it."""
    problem = f"is {kind} file, which is read with {library}, and {library} is not installed"
    return InputError("needs-extra", problem, f"run: pip install 'defocus[{extra}]'", path=path)


@contextmanager
def opened_image(path: Path, refusal: Callable[[str], InputError]) -> Iterator[Any]:
    """Yield the OpenImageIO input of a file, without limits of size or conversion of samples.

    `refusal`: makes the error from OpenImageIO's message if the file cannot be opened.
    """
    with delayed_signals():
        import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    for name in ("limits:imagesize_MB", "limits:channels"):  # by default the memory, 1024
        oiio.attribute(name, 0)
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), config)
    if not file:
        why = first_line(path, oiio.geterror())
        try:
            path.open("rb").close()
        except OSError as error:  # OpenImageIO gives no reason for PNG and JPEG
            why = reason(error)
        raise refusal(why)
    try:
        yield file
    finally:
        file.close()
        oiio.geterror()  # clears the error, which the next file would report


def decoded_rows(
    path: Path, file: Any, part: int, rows: tuple[int, int], channels: tuple[int, int], kind: str
) -> NDArray[Any]:
    """Rows [h, W, C] of an `opened_image`, as they are in the file.

    `part`: index of the image in the file; `rows`, `channels`: (first, end) of each; `kind`: the
    type of the numbers.
    """
    spec = file.spec()
    if spec.tile_width:
        place = (spec.x, spec.x + spec.width, *rows, spec.z, spec.z + 1)
        samples = file.read_tiles(part, 0, *place, *channels, kind)
    else:
        samples = file.read_scanlines(part, 0, *rows, spec.z, *channels, kind)
    # A truncated JPEG comes back filled with grey, and only the error flag says so.
    if samples is None or file.has_error:
        why = first_line(path, file.geterror())
        if not any(words in why for words in _NO_CODEC):
            raise damaged(path, why)
        problem = f"is compressed by a codec that is not read here ({why.rpartition(': ')[2]})"
        raise InputError("unsupported", problem, "save it with ZIP or LZW", path=path)
    decoded: NDArray[Any] = samples.reshape(rows[1] - rows[0], spec.width, -1)
    return decoded


@contextmanager
def decoding(path: Path, what: str = "is truncated or damaged") -> Iterator[None]:
    """Convert exceptions of a decoder in the block into the InputError for damage."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise damaged(path, reason(error), what) from error
