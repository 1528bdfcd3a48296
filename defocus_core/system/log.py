"""What the library says while it works, to the logger ``defocus_core``."""

from __future__ import annotations

from logging import getLogger

_LOGGER = getLogger("defocus_core")


def note(line: str) -> None:
    """One line for the user, as a warning: Python prints it on stderr if nobody listens."""
    _LOGGER.warning("%s", line)
