"""Jobs as plain JSON values and back, for journals and workers.

Fields that have their default are left out, so that a field that is new in a version changes
nothing for jobs that do not use it. Infinity is the word ``inf``, NaN ``nan``.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def plain(value: Any) -> Any:
    """A value without classes: dataclasses become dictionaries, tuples lists, paths text."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        return {f.name: plain(v) for f, v in fields if v != f.default}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def typed(kind: type[T], value: Any) -> T:
    """The dataclass of a kind that `plain` made a dictionary of."""
    try:
        result: T = _typed(kind, value)
    except (TypeError, KeyError, AttributeError, IndexError) as error:
        raise ValueError(f"is no {kind.__name__}: {error}") from None
    return result


def _typed(kind: Any, value: Any) -> Any:
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        options = [option for option in typing.get_args(kind) if option is not type(None)]
        return None if value is None else _typed(options[0], value)
    if origin is tuple:
        kinds = typing.get_args(kind)
        if kinds[-1] is Ellipsis:
            return tuple(_typed(kinds[0], item) for item in value)
        return tuple(_typed(*pair) for pair in zip(kinds, value, strict=True))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = _hints(kind)
        return kind(**{name: _typed(hints[name], item) for name, item in value.items()})
    return kind(value)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)
