"""A second process that renders the same picture, so that both do half of it.

Threads of one process hand the interpreter to and fro at each of the many short steps of a tile. So
a copy of the process does what the process does, in the same order, from the same numbers; but of
the pieces of work that are shared out each is done by one of them, and sent to the other. Whatever
becomes of the helper, the picture is the same: what it does not deliver is done without it.
"""

from __future__ import annotations

import math
import mmap
import os
import signal
import socket
import struct
import sys
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NoReturn

from defocus_cli import memory
from defocus_cli.errors import reason
from defocus_cli.sharing import Claims, Member

_KIB = 2**10
# Pixels of the least picture that is worth a second process: of more than two threads, which wait
# for each other longer, and of two.
_HELPED, _HELPED_OF_TWO = 1 << 20, 1 << 22
_NUMBER = struct.Struct("d")


@dataclass
class Helper:
    """What became of a helper; known after its block.

    Attributes:
        lost: why it did not do its part; empty if it did.
        cpu_seconds: that it computed.
        grown_mb: what it held at most beyond what it began with.
    """

    lost: str = ""
    cpu_seconds: float = 0.0
    grown_mb: float = 0.0


def can_help() -> bool:
    """Whether this system copies processes, and lets two see the same memory."""
    return sys.platform == "linux" and hasattr(os, "memfd_create")


def is_helped(threads: int, device: str, size: Sequence[int]) -> bool:
    """Whether a second process is of use for a picture of (height, width) px."""
    least = _HELPED if threads > 2 else _HELPED_OF_TWO
    return threads > 1 and device == "cpu" and math.prod(size) >= least and can_help()


@contextmanager
def helped(work: Callable[[], Iterable[object]], *, wanted: bool = True) -> Iterator[Helper]:
    """In the block, what is shared out is shared with a process that does `work` meanwhile.

    Args:
        work: the same as the block, but for what is done with the results; these are gone through.
        wanted: whether there is such a process at all.
    """
    from defocus_core.threads import shared

    if not wanted:
        yield Helper()
        return
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    claims, helper = Claims(), Helper()
    begun_mb = mmap.mmap(-1, _NUMBER.size)  # of the helper, seen by both
    _NUMBER.pack_into(begun_mb, 0, math.inf)
    memory.trim()  # what is free would be copied, and not be counted as what the helper took
    try:
        with warnings.catch_warnings():  # Python 3.12 warns of other threads: it needs none of them
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
    except OSError as error:
        for each in (here, there, claims, begun_mb):
            each.close()
        yield Helper(lost=f"could not begin: {reason(error)}")
        return
    if process == 0:
        here.close()
        _help(work, there, claims, begun_mb)
    there.close()
    member = Member(here, claims, helps=False)
    try:
        with shared(member.share):
            yield helper
    finally:
        early = member.alone
        os.kill(process, signal.SIGKILL)
        _, status, used = os.wait4(process, 0)
        member.close()
        claims.close()
        helper.cpu_seconds = used.ru_utime + used.ru_stime
        (held_mb,) = _NUMBER.unpack_from(begun_mb)
        helper.grown_mb = max(0.0, used.ru_maxrss * _KIB / memory.MB - held_mb)
        begun_mb.close()
        if member.stuck:
            helper.lost = "did not answer"
        elif early and status:
            helper.lost = _ending(status)


def _help(
    work: Callable[[], Iterable[object]],
    channel: socket.socket,
    claims: Claims,
    begun_mb: mmap.mmap,
) -> NoReturn:
    """What the helper does; the process ends with it."""
    from defocus_core.threads import shared

    code = 1
    try:
        _NUMBER.pack_into(begun_mb, 0, memory.held_mb())  # not all that the other holds
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # reaches both, and the other ends this one
        for number in (signal.SIGTERM, signal.SIGHUP):
            if callable(signal.getsignal(number)):
                signal.signal(number, signal.SIG_DFL)
        with shared(Member(channel, claims, helps=True).share):
            deque(work(), 0)
        code = 0
    finally:
        os._exit(code)


def _ending(status: int) -> str:
    """How a process ended that should not have."""
    if os.WIFSIGNALED(status):
        return f"was ended by {signal.Signals(os.WTERMSIG(status)).name}"
    return "failed"
