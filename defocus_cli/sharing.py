"""Pieces of work, shared by two processes that both come by them: each is done by one of them."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from itertools import count
from typing import Any

from defocus_cli.parcels import Parcel, receive, send

# Seconds that a result is waited for, besides some times as many as the longest piece took that was
# done here: then the other process is taken for stuck.
_PATIENCE, _TIMES = 20, 10
_BYTES = 4  # of the number of a piece


class Claims:
    """Which piece is next: each is given out once, and nothing is locked by a process that ends."""

    def __init__(self) -> None:
        self._file = os.memfd_create("defocus claims")
        self._threads = threading.Lock()  # that of a file does not keep threads apart

    def next_of(self, call: int) -> int:
        """The number of the next piece of a call."""
        at = call * _BYTES
        with self._threads:
            fcntl.lockf(self._file, fcntl.LOCK_EX)
            try:
                piece = int.from_bytes(os.pread(self._file, _BYTES, at), "little")
                os.pwrite(self._file, (piece + 1).to_bytes(_BYTES, "little"), at)
            finally:
                fcntl.lockf(self._file, fcntl.LOCK_UN)
        return piece

    def close(self) -> None:
        """Give none out any more."""
        os.close(self._file)


class Member:
    """One of the two processes.

    Attributes:
        alone: whether nothing comes from the other any more.
        stuck: whether that is because it did not answer.
    """

    def __init__(self, channel: socket.socket, claims: Claims, *, helps: bool) -> None:
        """Begin to receive what the other sends.

        Args:
            channel: to the other.
            claims: of both.
            helps: whether this is the one whose results nobody takes; it ends with the other, or
                when it cannot go on.
        """
        self.alone = self.stuck = False
        self._channel, self._claims, self._helps = channel, claims, helps
        self._calls = count()
        self._results: dict[tuple[int, int], Future[Any]] = {}
        self._changed = threading.Condition()
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", _PATIENCE, 0))
        self._receiving = threading.Thread(target=self._receive, name="receiver", daemon=True)
        self._receiving.start()

    def close(self) -> None:
        """Receive nothing any more."""
        with suppress(OSError):  # the other has closed it
            self._channel.shutdown(socket.SHUT_RDWR)
        self._receiving.join()
        self._channel.close()

    def share(
        self, work: Callable[[Any], Any], pieces: Sequence[Any], threads: int, last: bool
    ) -> Iterator[Any]:
        """The results of work on each piece, in order, `Sharing` of the core.

        Who helps gets none of what comes last.
        """
        from defocus_core.threads import carried

        call, mine, longest = next(self._calls), set[int](), [0.0]
        ended = threading.Event()

        def do(piece: int) -> None:
            mine.add(piece)
            start = time.monotonic()
            found = self._done(work, pieces[piece])
            longest.append(time.monotonic() - start)
            if not found.exception() and (self._helps or not last):
                self._send(Parcel(call, piece, found.result()))
            if not (self._helps and last):
                self._put(call, piece, found)

        def do_next() -> bool:
            """Whether there was one."""
            found = not ended.is_set() and (piece := self._claims.next_of(call)) < len(pieces)
            if found:
                do(piece)
            return found

        def do_all() -> None:
            while do_next():
                pass

        # of an odd number of threads who helps has one less
        beside = max(0, (threads + (not self._helps)) // 2 - 1)
        with ThreadPoolExecutor(beside or 1) as pool:
            everything = carried(lambda _: do_all())
            for thread in range(beside):
                pool.submit(everything, thread)
            try:
                if self._helps and last:
                    do_all()
                    return
                more = True
                for piece in range(len(pieces)):
                    while (call, piece) not in self._results:
                        if more:
                            more = do_next()
                        elif self.alone and piece not in mine:
                            do(piece)
                        else:
                            self._wait(call, piece, None if piece in mine else max(longest))
                    yield self._results.pop((call, piece)).result()
            finally:
                ended.set()

    def _done(self, work: Callable[[Any], Any], piece: Any) -> Future[Any]:
        """The result of a piece, or the error for whoever takes it."""
        from defocus_core.threads import shared

        found: Future[Any] = Future()
        try:
            with shared(None):
                found.set_result(work(piece))
        except BaseException as error:
            if self._helps:
                os._exit(1)
            found.set_exception(error)
        return found

    def _send(self, parcel: Parcel) -> None:
        with suppress(OSError):  # of that the receiver is told
            send(self._channel, parcel)

    def _put(self, call: int, piece: int, found: Future[Any]) -> None:
        with self._changed:
            self._results[call, piece] = found
            self._changed.notify_all()

    def _receive(self) -> None:
        try:
            with suppress(OSError):  # the other has ended in the midst of it
                while (parcel := receive(self._channel)) is not None:
                    found: Future[Any] = Future()
                    found.set_result(parcel.result)
                    self._put(parcel.call, parcel.piece, found)
        finally:
            if self._helps:
                os._exit(1)
            with self._changed:
                self.alone = True
                self._changed.notify_all()

    def _wait(self, call: int, piece: int, longest: float | None) -> None:
        """Until there is the result, or somebody else has to do the piece.

        Args:
            call: that shared it out.
            piece: its number.
            longest: seconds that a piece took here; None if this process does it.
        """

        def over() -> bool:
            return (call, piece) in self._results or (self.alone and longest is not None)

        patience = None if self._helps or longest is None else _PATIENCE + _TIMES * longest
        with self._changed:
            if not self._changed.wait_for(over, patience):
                self.stuck = self.alone = True
