"""Entry point of ``defocus`` and ``python -m defocus_cli``, which also ends the process."""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False  # as typing has it, whose import takes 10 ms
if TYPE_CHECKING:
    from typing import NoReturn


def _end(*_: object) -> NoReturn:
    """End the process without a traceback, if Ctrl-C is pressed while modules are imported."""
    try:
        os.write(2, b"defocus: interrupted\n")
    finally:
        os._exit(130)


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)

import atexit  # noqa: E402  after the handler: imports take 0.2 s
import sys  # noqa: E402
from contextlib import suppress  # noqa: E402

from defocus_cli.main import main  # noqa: E402


def run() -> NoReturn:
    """Run the command line, and end the process with its exit code."""
    codes: list[int] = []
    atexit.register(_leave, codes)  # registered first, so that it runs last
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    codes.append(main())
    sys.exit(codes[0])


def _leave(codes: list[int]) -> None:
    """End the process at once with the exit code in `codes`, if any: unloading PyTorch is slow."""
    with suppress(OSError, ValueError):  # nobody reads the output; Python would report it
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        for code in codes:
            os._exit(code)


if __name__ == "__main__":
    run()
