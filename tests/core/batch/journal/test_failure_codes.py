"""Each way to fail has a code of the closed list."""

import errno
import os
import re
from pathlib import Path

import pytest

from defocus_core.batch.journal.record import FAILURES, REJECTIONS, failure
from defocus_core.errors import InputError, Rejected, TooLarge, UsageProblem
from defocus_core.io.safe_files import unwritable

SOURCES = sorted(Path(__file__).parents[4].glob("defocus_c*/**/*.py"))
HERE = Path("a.exr")


def full():
    system = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    error = unwritable(HERE, system)
    error.__cause__ = system
    return error


@pytest.mark.parametrize(
    ("error", "step", "status", "reason"),
    [
        (InputError("", "is damaged", path=HERE), "read", "failed", "input-unusable"),
        (FileNotFoundError(errno.ENOENT, "gone", "a.exr"), "read", "failed", "input-unusable"),
        (
            UsageProblem("", "lies outside", field="focus-at"),
            "render",
            "failed",
            "settings-unusable",
        ),
        (TooLarge("", "does not fit", path=HERE), "render", "failed", "out-of-memory"),
        (MemoryError(), "write", "failed", "out-of-memory"),
        (RuntimeError("[enforce fail] can't allocate memory"), "render", "failed", "out-of-memory"),
        (InputError("", "cannot be written", path=HERE), "write", "failed", "output-unwritable"),
        (full(), "write", "failed", "no-space"),
        (RuntimeError("wires crossed"), "render", "failed", "fault"),
        (Rejected("coc-too-large", "blurs", "", path=HERE), "render", "rejected", "coc-too-large"),
    ],
)
def test_an_exception_has_a_status_and_a_reason(error, step, status, reason):
    found = failure(error, step, {})
    assert (found.status, found.reason) == (status, reason)
    assert found.message
    assert "\n" not in found.message


def test_codes_of_rejections_are_all_listed():
    text = "".join(path.read_text() for path in SOURCES if path.stem == "focus")
    codes = set(re.findall(r'Rejected\(\s*"([a-z-]+)"', text))
    assert codes == set(REJECTIONS)
    assert not codes & set(FAILURES)
