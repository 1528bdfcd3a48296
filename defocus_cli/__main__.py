"""Entry point of ``defocus`` and ``python -m defocus_cli``, and how the process ends."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn


def _end(*_: object) -> NoReturn:
    """End without a traceback: Ctrl-C while the modules of the command line are imported."""
    with suppress(OSError):
        os.write(2, b"defocus: interrupted\n")
    os._exit(130)


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)

from defocus_cli.main import main  # noqa: E402  it takes 0.2 s


def run() -> NoReturn:
    """Carry out the command line, and leave with its exit code."""
    codes: list[int] = []
    atexit.register(_leave, codes)  # first: what others register comes before
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    codes.append(main())
    sys.exit(codes[0])


def _leave(codes: list[int]) -> None:
    """End at once: all is written, and taking PyTorch down takes a third of a second."""
    with suppress(OSError, ValueError):  # nobody reads what is printed: Python says so
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        for code in codes:
            os._exit(code)


if __name__ == "__main__":
    run()
