"""Work counted in calls of functions, which depend on no machine and on no other work."""

import sys


def calls(work, name=None):
    """How many functions (or one of this name) are called in this thread, Python's and C's."""
    count = 0

    def note(frame, event, argument):
        nonlocal count
        called = {"call": frame.f_code, "c_call": argument}.get(event)
        if called is not None:
            short = called.co_name if event == "call" else called.__name__
            count += name in (None, short)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count
