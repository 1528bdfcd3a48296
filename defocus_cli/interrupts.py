"""Ctrl-C: pressed once, what has been begun is finished; pressed again, all stops."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from defocus_cli import report


class Interrupts:
    """While the block runs, the first Ctrl-C is remembered, and a second one raises.

    Args:
        patient: False if the first one raises, too.
    """

    def __init__(self, *, patient: bool) -> None:
        self.asked = False
        self._patient = patient
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._pressed)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _pressed(self, number: int, frame: FrameType | None) -> None:
        if self.asked or not self._patient:
            raise KeyboardInterrupt
        self.asked = True
        report.say("finishing what is being rendered; press Ctrl-C again to stop at once")
