"""Which tests were skipped, and why; where ``CI`` is set, most reasons fail the run."""

import os
from collections import Counter

import pytest

# What the machine of a CI may lack; what never runs anywhere rots.
ALLOWED = ("needs a GPU", "needs ../shared", "runs as root", "not on this system")


def skipped(terminal):
    """How many tests were skipped for each reason."""
    reports = terminal.stats.get("skipped", [])
    reasons = (str(report.longrepr[2]) for report in reports if isinstance(report.longrepr, tuple))
    return Counter(reason.removeprefix("Skipped: ") for reason in reasons)


def fails_the_run(reason):
    """Whether a test must not be skipped here for a reason."""
    return bool(os.environ.get("CI")) and not reason.startswith(ALLOWED)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session):
    """Fail a run that was to pass."""
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None or hasattr(session.config, "workerinput") or session.exitstatus:
        return
    if any(map(fails_the_run, skipped(terminal))):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter):
    """One line for each reason."""
    for reason, count in sorted(skipped(terminalreporter).items()):
        word = "SKIPPED, which fails the run" if fails_the_run(reason) else "skipped"
        terminalreporter.write_line(f"{count} {word}: {reason}")
