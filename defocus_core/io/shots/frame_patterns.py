"""Frame patterns: paths that number the frames of a shot, and the choice of frames.

``shot.####.exr``, ``shot.%04d.exr``, Houdini's ``shot.$F4.exr`` and ``shot.@@@@.exr`` stand for
``shot.1001.exr`` and so on, with numbers of at least four digits.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from defocus_core.errors import CALLER, InputError, Place, UsageProblem
from defocus_core.system.text import counted

MISSING = ("error", "skip")
_FIELD = re.compile(r"#+|%0?\d*d")
_OTHER_FIELD = re.compile(r"\$F(\d{0,2})|@{2,}")
_RANGE = re.compile(r"\d+-\d+(x\d+)?[#@]")  # frames inside a pattern, as some programs write them
_DIGITS = 18  # greatest number of digits of a frame
_LONGEST_LIST = 2**16  # characters
_MAX_FRAMES = 2**20  # from the first to the last, if no frames are asked for
_EXAMPLE = "write them like 1001-1240, 1001-1240x2 or 1001,1005-1010"


@dataclass(frozen=True)
class FrameChoice:
    """The choice of the frames of a shot to render."""

    numbers: tuple[int, ...] | None = None  # the frames, ascending; None for all with files
    missing: str = "error"  # what is done with frames without a file: ``error`` or ``skip``
    # The option that names the frames, for errors
    source: Place = field(default=CALLER.with_field("frames"), compare=False)


ALL = FrameChoice()


def is_pattern(path: Path) -> bool:
    """Whether a path is a frame pattern and does not exist as a file of that name."""
    return _FIELD.search(_with_hashes(path).name) is not None and not path.exists()


def _with_hashes(path: Path) -> Path:
    """A frame pattern with # in place of $F and @, one for each digit."""

    def hashes(found: re.Match[str]) -> str:
        return "#" * (int(found[1] or 1) if found[0][0] == "$" else len(found[0]))

    return path.with_name(_OTHER_FIELD.sub(hashes, path.name)) if path.name else path


def frame_numbers(text: str, where: Place) -> tuple[int, ...]:
    """The frames of a text like ``1001-1240x2,1300``, ascending; `where`: its place, for errors."""
    from fileseq.exceptions import MaxSizeException
    from fileseq.frameset import FrameSet

    if len(text) > _LONGEST_LIST:
        problem = f"has {len(text)} characters, of which {_LONGEST_LIST} are read"
        raise UsageProblem("malformed", problem, _EXAMPLE, path=where)
    try:
        numbers = sorted({int(number) for number in FrameSet(text.replace(" ", ""))})
    except MaxSizeException:
        problem = f"'{text}' is too many frames"
        raise UsageProblem("too-large", problem, "ask for fewer", path=where) from None
    except ValueError:
        numbers = []
    if not numbers or "." in text:
        raise UsageProblem("malformed", f"'{text}' names no frames", _EXAMPLE, path=where)
    return tuple(numbers)


def frames_of(pattern: Path) -> dict[int, Path]:
    """The files of a frame pattern by number, ascending."""
    pattern = _with_hashes(pattern)
    fields = _FIELD.findall(pattern.name)
    if len(fields) > 1:
        problem = "has two numbers in its name"
        raise InputError("ambiguous", problem, "give a pattern with one", path=pattern)
    width = len(fields[0]) if "#" in fields[0] else int(fields[0].strip("%d") or 1)
    if width > _DIGITS:
        problem = f"asks for more than {_DIGITS} digits"
        raise InputError("out-of-range", problem, "write it like %04d", path=pattern)
    before, after = map(re.escape, pattern.name.split(fields[0]))
    # a sign may take the place of a digit; more digits than asked for have no zero before them
    number = rf"-\d{{{max(width - 1, 1)}}}|-?(?:\d{{{width}}}|[1-9]\d{{{width},}})"
    name = re.compile(f"{before}({number}){after}", re.ASCII)
    listed = os.listdir(pattern.parent) if pattern.parent.is_dir() else []  # noqa: PTH208 - names
    texts = {found[1]: found[0] for found in map(name.fullmatch, listed) if found}
    if any(len(text) > _DIGITS + 1 for text in texts):
        problem = "matches a file whose number is too long for a frame"
        raise InputError("out-of-range", problem, "move that file away", path=pattern)
    if not texts:
        remedy = "check the path; each # stands for a digit, and %04d is ####"
        if _RANGE.search(pattern.name):
            remedy = "write 'shot.####.exr', and the range as ‹frames› 1001-1005"
        raise InputError("not-found", "matches no file", remedy, path=pattern)
    return {int(text): pattern.with_name(texts[text]) for text in sorted(texts, key=int)}


def chosen(
    patterns: Mapping[Path, Mapping[int, Path]], choice: FrameChoice
) -> tuple[tuple[int, ...], str]:
    """The frames to render, which have a file in every pattern, and a note on frames skipped.

    `patterns`: the files of each pattern by frame.
    """
    wanted = choice.numbers or expected({n for files in patterns.values() for n in files})
    lacking = {
        pattern: lost
        for pattern, files in patterns.items()
        if (lost := [number for number in wanted if number not in files])
    }
    words = "; ".join(f"{path} lacks {in_words(lost)}" for path, lost in lacking.items())
    if not lacking:
        return wanted, ""
    if choice.missing == "error":
        path, lost = next(iter(lacking.items()))
        others = "".join(f", {other} {in_words(n)}" for other, n in [*lacking.items()][1:])
        remedy = "give ‹missing› skip to leave them out, or name others with ‹frames›"
        raise InputError("missing-frames", f"lacks {in_words(lost)}{others}", remedy, path=path)
    kept = tuple(number for number in wanted if all(number in of for of in patterns.values()))
    if not kept:
        path = next(iter(lacking))
        remedy = "check ‹frames›"
        raise InputError("missing-frames", f"lacks {in_words(lacking[path])}", remedy, path=path)
    return kept, words


def expected(numbers: Iterable[int]) -> tuple[int, ...]:
    """The given frames, completed to a regular numbering from the first to the last.

    The step is the most common difference of consecutive frames.
    """
    there = sorted(numbers)
    steps = [after - before for before, after in pairwise(there)]
    if not steps:
        return tuple(there)
    count = Counter(steps)
    step = max(sorted(count), key=lambda each: count[each])
    if (there[-1] - there[0]) // step > _MAX_FRAMES:
        problem = f"the numbers of the files go from {there[0]} to {there[-1]}"
        remedy = "move away files that are no frames, or give the frames, like 1-100"
        raise UsageProblem("out-of-range", problem, remedy, field="frames")
    return tuple(sorted({*there, *range(there[0], there[-1], step)}))


def gaps(numbers: Iterable[int]) -> tuple[int, ...]:
    """The frames missing in a regular numbering; see `expected`."""
    there = set(numbers)
    return tuple(number for number in expected(there) if number not in there)


def in_words(numbers: Iterable[int]) -> str:
    """The number of frames and their ranges, as ``3 frames, 1005, 1010-1011``."""
    from fileseq.frameset import FrameSet

    every = sorted(numbers)
    ranges = FrameSet.framesToFrameRange(every).replace(",", ", ")
    return f"{counted(len(every), 'frame')}, {ranges}"
