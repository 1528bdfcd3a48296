"""Each way to fail has a code of the closed list."""

import errno
import os
from pathlib import Path

import pytest

from defocus_core import InputError, UsageProblem
from defocus_core.batch.journal.record import failure
from defocus_core.errors import TooLarge
from defocus_core.io.write_files import unwritable

HERE = Path("a.exr")


def full():
    system = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    error = unwritable(HERE, system)
    error.__cause__ = system
    return error


@pytest.mark.parametrize(
    ("error", "step", "reason"),
    [
        (InputError("", "is damaged", path=HERE), "read", "input-unusable"),
        (FileNotFoundError(errno.ENOENT, "gone", "a.exr"), "read", "input-unusable"),
        (UsageProblem("", "lies outside", field="focus-at"), "render", "settings-unusable"),
        (TooLarge("", "does not fit", path=HERE), "render", "out-of-memory"),
        (MemoryError(), "write", "out-of-memory"),
        (RuntimeError("[enforce fail] can't allocate memory"), "render", "out-of-memory"),
        (InputError("", "cannot be written", path=HERE), "write", "output-unwritable"),
        (full(), "write", "no-space"),
        (RuntimeError("wires crossed"), "render", "fault"),
    ],
)
def test_an_exception_has_a_reason(error, step, reason):
    found = failure(error, step, {})
    assert found.reason == reason
    assert found.message
    assert "\n" not in found.message
