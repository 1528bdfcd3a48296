"""Work counted in calls of functions, which depend on no machine and on no other work."""

import sys


def calls(work):
    """How many functions are called meanwhile in this thread, Python's and those of C."""
    count = 0

    def note(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count
