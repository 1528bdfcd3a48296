"""Ctrl-C, and the signals that end a process.

The first Ctrl-C lets the pictures that have been begun be finished; the second one stops at once.
SIGTERM and SIGHUP stop at once, since their sender may not wait: no file is left half written.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from defocus_core.system.text import note

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Terminated(BaseException):
    """The system ends this process; ``number`` is that of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def signal_name(self) -> str:
        """Like SIGTERM."""
        return signal.Signals(self.number).name


@contextmanager
def terminations() -> Iterator[None]:
    """In the block, signals that would end the process raise `Terminated`, the first of them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: FrameType | None) -> None:
        for other in before:
            signal.signal(other, signal.SIG_IGN)
        raise Terminated(number)

    # A signal that nohup ignores stays ignored.
    before = [number for number in _ENDING if signal.getsignal(number) == signal.SIG_DFL]
    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in before:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def delayed_signals() -> Iterator[None]:
    """Delay signals to the end: an import that they interrupt loses them, or half a module."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: arrived.append(number))
        for number in (signal.SIGINT, *_ENDING)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in arrived:
        signal.raise_signal(number)


class Interrupts:
    """While the block runs, the first Ctrl-C is remembered, and a second one raises."""

    def __init__(self, *, patient: bool) -> None:
        self.asked = False
        self._patient = patient
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._pressed)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _pressed(self, number: int, frame: FrameType | None) -> None:
        if self.asked or not self._patient:
            raise KeyboardInterrupt
        self.asked = True
        note("finishing what is being rendered; press Ctrl-C again to stop at once")
