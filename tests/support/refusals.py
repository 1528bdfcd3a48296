"""What the library refuses: a mistake of the user, by its code."""

import resource
from contextlib import contextmanager

import pytest

from defocus_core import DefocusError


@contextmanager
def refuses(code, *facts, kind=DefocusError, field=None, value=None, path=None):
    """Assert that the block raises the mistake, and that its problem or remedy has the facts."""
    with pytest.raises(kind) as caught:
        yield caught
    error = caught.value
    assert error.code == code, str(error)
    assert field is None or error.field == field, str(error)
    assert value is None or error.value == value, str(error)
    assert path is None or error.path == str(path), str(error)
    for fact in facts:
        assert fact in f"{error.problem}; {error.remedy}"


@contextmanager
def refuses_as(refusal):
    """As ``refuses``, from one cell of a table: the code and, after a space, the field, if any."""
    code, _, field = refusal.partition(" ")
    with refuses(code, field=field or None) as caught:
        yield caught


@contextmanager
def files_end_at(size):
    """No file can grow beyond so many bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
