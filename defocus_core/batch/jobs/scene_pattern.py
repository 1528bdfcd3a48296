"""Regular expressions that end: the scene in the name of a picture, as a jobs file describes it.

A jobs file may come from anywhere, and Python's matcher takes years for some expressions. Here each
place of an expression is tried once at each character of a name, in Python's order: what is found
is what Python finds, unless what may be empty is repeated. There are no references to groups, and
no looking ahead or behind.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_LONGEST = 1000  # steps of an expression, with its counted repeats written out
_TOKEN = re.compile(
    r"(?P<group>\((?!\?)|\(\?P<\w+>)|(?P<open>\(\?:)|(?P<close>\))|(?P<or>\|)"
    r"|(?P<repeat>(?:[*+?]|\{(?:\d+|\d*,\d*)\})\??(?!\+))"
    r"|(?P<one>\\\D|\[\^?\]?(?:\\.|[^\]\\])*\]|[^\\\[()|*+?{])",
    re.S,
)
# A step takes 0 or 1 character, which an expression matches; or notes the place; or goes on
# elsewhere, at offsets of which the first is preferred.
_Step = re.Pattern[str] | str | tuple[int, ...]


class ScenePattern:
    """A regular expression whose first group, or else whole match, is the scene in a name."""

    def __init__(self, text: str) -> None:
        try:
            self._has_group = re.compile(text).groups > 0
            self._steps = _Parser(text).steps
        except (re.error, RecursionError, OverflowError) as error:
            raise ValueError(str(error)) from None

    def scene(self, name: str) -> str | None:
        """The scene in a name; None if there is none."""
        tried: set[tuple[int, int]] = set()
        for start in range(len(name) + 1):
            waiting: list[tuple[int, int, dict[str, int]]] = [(0, start, {})]
            while waiting:
                step, at, noted = waiting.pop()
                if (step, at) in tried:
                    continue
                tried.add((step, at))
                if step == len(self._steps):
                    if not self._has_group:
                        return name[start:at]
                    return name[noted["begin"] : noted["end"]] if "end" in noted else None
                action = self._steps[step]
                if isinstance(action, tuple):
                    waiting += [(step + offset, at, noted) for offset in reversed(action)]
                elif isinstance(action, str):
                    waiting.append((step + 1, at, {**noted, action: at}))
                elif found := action.match(name, at):
                    waiting.append((step + 1, found.end(), noted))
        return None


class _Parser:
    """The steps of an expression that Python has found to be one."""

    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            token = _TOKEN.match(text, at)
            if token is None:
                raise ValueError(f"{text[at : at + 3]} is not known here")
            self._tokens.insert(0, (str(token.lastgroup), token[0]))
            at = token.end()
        self._has_noted = False
        self.steps = self._alternatives()

    def _alternatives(self) -> list[_Step]:
        """The steps up to the end of a group."""
        steps: list[_Step] = []
        item: list[_Step] = []
        while self._tokens and self._tokens[-1][0] != "close":
            kind, text = self._tokens.pop()
            if kind == "or":
                others = self._alternatives()
                return [(1, len(steps + item) + 2), *steps, *item, (len(others) + 1,), *others]
            if kind == "repeat":
                item = _repeat(item, text)
            else:
                steps, item = steps + item, self._item(kind, text)
            if len(steps) + len(item) > _LONGEST:
                raise ValueError(f"it has more than {_LONGEST} steps")
        return steps + item

    def _item(self, kind: str, text: str) -> list[_Step]:
        """The steps of a character, or of a group up to its end."""
        if kind == "one":
            return [re.compile(text)]
        is_noted = kind == "group" and not self._has_noted
        self._has_noted |= is_noted
        item = self._alternatives()
        self._tokens.pop()
        return ["begin", *item, "end"] if is_noted else item


def _repeat(item: Sequence[_Step], text: str) -> list[_Step]:
    """The steps of an item that is repeated, as ``*`` or ``{2,3}?`` says."""
    order = -1 if len(text) > 1 and text.endswith("?") else 1
    size = len(item)
    maybe: list[_Step] = [(1, size + 1)[::order], *item]
    any_number: list[_Step] = [(1, size + 2)[::order], *item, (-size - 1,)]
    match text[0]:
        case "?":
            return maybe
        case "*":
            return any_number
        case "+":
            return [*item, (-size, 1)[::order]]
    least, comma, most = text.strip("{}?").partition(",")
    fewest = int(least or 0)
    more = int(most) - fewest if most else 0
    if size * (fewest + more) > _LONGEST:
        raise ValueError(f"it has more than {_LONGEST} steps")
    return [*list(item) * fewest, *(any_number if comma and not most else maybe * more)]
