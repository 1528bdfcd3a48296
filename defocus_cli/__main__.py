"""Entry point of ``defocus`` and ``python -m defocus_cli``, and how the process ends."""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress
from typing import NoReturn

from defocus_cli.main import main


def run() -> NoReturn:
    """Carry out the command line, and leave with its exit code."""
    codes: list[int] = []
    atexit.register(_leave, codes)  # first: what others register comes before
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
