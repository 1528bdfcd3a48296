"""Damaged files: one error for what no decoder can make sense of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from defocus_core.errors import InputError, reason

AGAIN = "write or copy it again"
# What is raised where a foreign document, JSON that may be anything, is taken for one of ours.
MALFORMED = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError)


def damaged(path: Path, why: str, what: str = "is truncated or damaged") -> InputError:
    """The error for a file that cannot be decoded."""
    return InputError("damaged", f"{what} ({why})", AGAIN, path=path)


@contextmanager
def decoding(path: Path, what: str = "is truncated or damaged") -> Iterator[None]:
    """Turn what a library raises in the block, half a dozen types, into the error for damage."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise damaged(path, reason(error), what) from error
