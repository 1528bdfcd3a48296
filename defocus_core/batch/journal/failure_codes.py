"""Reason codes of failed and rejected jobs: a closed list.

A job is ``rejected`` where the picture cannot be taken as asked: trying again does not change that.
It has ``failed`` where something went wrong.
"""

from __future__ import annotations

import errno
from typing import Literal, NamedTuple

from defocus_core.errors import (
    DefocusError,
    InputError,
    Rejected,
    TooLarge,
    UsageProblem,
    one_line,
    reason,
)

REJECTIONS = {
    "coc-too-large": "the blur would be larger than max-coc allows",
    "no-valid-depth": "there is nothing to focus on",
    "focus-too-near": "the depth puts the focus nearer than the focal length",
}
FAILURES = {
    "input-unusable": "an input is missing, damaged, or not what it is said to be",
    "settings-unusable": "the settings make no sense for this picture or machine",
    "out-of-memory": "the picture does not fit into memory",
    "output-unwritable": "an output cannot be written",
    "no-space": "no space is left where the outputs go",
    "worker-died": "the process that computed it died, several times",
    "fault": "a fault of defocus itself",
}
REASONS = REJECTIONS | FAILURES
STATUSES = ("ok", "rejected", "failed")
Step = Literal["read", "render", "write"]
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Verdict(NamedTuple):
    """Status and reason code of a job without outputs, and its message for people."""

    status: str
    reason: str
    message: str


def verdict(error: BaseException, step: Step) -> Verdict:
    """The verdict on a job of which an exception ended a step."""
    if isinstance(error, Rejected) and error.code in REJECTIONS:
        return Verdict("rejected", error.code, str(error))
    return Verdict("failed", _failure(error, step), error_line(error))


def error_line(error: BaseException) -> str:
    """An exception in one line, ``SUBJECT: problem; remedy`` where a user can mend it."""
    if isinstance(error, DefocusError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return one_line(f"{error.filename}: {reason(error)}")
    return f"unexpected {type(error).__name__}: {reason(error)}"


def _failure(error: BaseException, step: Step) -> str:
    system = error if isinstance(error, OSError) else error.__cause__
    if isinstance(system, OSError) and system.errno in _FULL:
        return "no-space"
    if isinstance(error, TooLarge | MemoryError) or "can't allocate memory" in str(error):
        return "out-of-memory"
    if isinstance(error, UsageProblem):
        return "settings-unusable"
    if isinstance(error, InputError | OSError):
        return "output-unwritable" if step == "write" else "input-unusable"
    return "fault"
