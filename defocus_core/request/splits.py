"""Splits of a dataset, like train and test. All pictures of a scene are in the same split.

The split of a scene depends on a hash of its name, so other scenes do not change it. A scene that
the journal records in a split stays there. `defocus help batch` describes the keys of ``[split]``.
"""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from hashlib import blake2b
from itertools import accumulate

from defocus_core.errors import Place, UsageProblem
from defocus_core.io.wildcards import has_wildcard, wild_text
from defocus_core.request.job import NO_SPLIT, SPLIT_NAME, Job, PictureFiles, Split
from defocus_core.request.toml_file import Table
from defocus_core.system.text import counted, note

_SCENE = "scene"
_ROUNDING = 1e-6


def read_splits(section: Table, pictures: Sequence[PictureFiles]) -> list[Split]:
    """The split of each picture, in order, by the table ``[split]``; `NO_SPLIT` without it."""
    fractions, counts = _shares(section)
    pattern, place = section.text(_SCENE), section.place(_SCENE)
    if pattern is not None:
        if not fractions and not counts:
            problem = "stands without shares"
            raise UsageProblem("missing-option", problem, "add train = 0.9", path=place)
        if not has_wildcard(pattern):
            remedy = 'write a pattern, like "*_##": * is the scene, # a digit'
            raise UsageProblem("malformed", f"'{pattern}' has no wildcard", remedy, path=place)
    if not fractions and not counts:
        return [NO_SPLIT] * len(pictures)
    where = section.place(next(iter(counts), _SCENE)) if pattern is None else place
    scenes = [_scene_of(picture, pattern, where) for picture in pictures]
    first, exact = sorted({*scenes}, key=_place_of), dict[str, str]()
    wanted = sum(counts.values())
    if wanted > len(first) or (counts and not fractions and wanted < len(first)):
        problem = f"the numbers ask for {counted(wanted, 'scene')}, and there are {len(first)}"
        remedy = "let the numbers add up to them, or give one split a share, as train = 1.0"
        raise UsageProblem("out-of-range", problem, remedy, path=where)
    for name, count in counts.items():
        exact |= dict.fromkeys(first[len(exact) : len(exact) + count], name)
    names, ends = list(fractions), [*accumulate(fractions.values())]
    for scene in first[len(exact) :]:  # the sum of shares may be slightly below 1
        exact[scene] = names[min(bisect_right(ends, _place_of(scene)), len(names) - 1)]
    return [Split(exact[scene], scene, (*counts, *fractions)) for scene in scenes]


def _scene_of(picture: PictureFiles, pattern: str | None, where: Place) -> str:
    """The name of the scene: what the wildcards of `pattern` match in the picture's name.

    Without a pattern, it is the name of the picture, without frame number.
    """
    name = picture.stem
    if pattern is None:
        return name if picture.frame is None else re.sub(r"\d+$", "", name)
    scene = wild_text(name, pattern)
    if not scene:
        problem = f"finds no scene in '{name}'"
        remedy = 'write a pattern that matches each name, like "*_##", or "*"'
        raise UsageProblem("no-scene", problem, remedy, path=where)
    return scene


def _place_of(scene: str) -> float:
    """A number from 0 to 1 that is derived from the hash of a scene's name."""
    digest = blake2b(os.fsencode(scene), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64


def with_recorded(
    jobs: Sequence[Job], recorded: Mapping[str, Collection[str]], *, all_scenes: bool = True
) -> list[Job]:
    """Jobs whose scenes keep the split in which the journal recorded them, if it still exists.

    `recorded` are the names of splits by name of picture; `all_scenes` tells whether `jobs` have
    all scenes of the batch. Notes tell how many scenes are kept against their hash, how many
    are in another split than before, and which splits are empty.
    """
    before: dict[Split, set[str]] = defaultdict(set)
    for job in jobs:
        before[job.split].update(recorded.get(job.picture.stem, ()))
    now = {
        split: split._replace(name=next(iter(names)))
        if len(names) == 1 and names <= set(split.choices)
        else split
        for split, names in before.items()
    }
    stay = sum(old != new for old, new in now.items())
    moved = sum(bool(old.choices) and not before[old] <= {new.name} for old, new in now.items())
    empty = {name for split in now for name in split.choices} - {s.name for s in now.values()}
    if stay:
        kept = f"{counted(stay, 'scene')} kept where the journal has it"
        note(f"[split]: {kept}, not where a hash of its name says; another -o splits anew")
    if moved:
        note(f"[split]: {counted(moved, 'scene')} in another split than before")
    if empty and all_scenes:
        none = f"none of {counted(len(now), 'scene')} is in {', '.join(sorted(empty))}"
        note(f"[split]: {none}: a hash of its name decides")
    return [
        replace(job, split=now[job.split]) if job.split != now[job.split] else job for job in jobs
    ]


def _shares(section: Table) -> tuple[dict[str, float], dict[str, int]]:
    """The shares, 0 to 1, of some splits by name; and the numbers of scenes of the other splits."""
    fractions, counts = {}, {}
    for name, value in section.values.items():
        if name == _SCENE:
            continue
        if not SPLIT_NAME.fullmatch(name):
            problem = "cannot be the name of a split"
            remedy = "use letters, digits and _"
            raise UsageProblem("malformed", problem, remedy, path=section.place(name))
        is_count = type(value) is int and value >= 1
        if not is_count and not (isinstance(value, float) and 0 < value <= 1):
            problem = f"{value!r} is not a share above 0, up to 1, nor a number of scenes"
            remedy = "write train = 0.9, or train = 24"
            raise UsageProblem("malformed", problem, remedy, path=section.place(name))
        if is_count and {*section.values} - {_SCENE} != {name}:
            counts[name] = value
        else:  # the only share has all scenes
            fractions[name] = float(value)
    if fractions and abs(sum(fractions.values()) - 1) > _ROUNDING:
        problem = f"has shares that add up to {sum(fractions.values()):g}"
        remedy = "let them add up to 1"
        raise UsageProblem("malformed", problem, remedy, path=section.file, field="[split]")
    return fractions, counts
