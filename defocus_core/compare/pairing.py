"""Pairs to compare: two files, and the pictures of two folders or of two finished batches."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import resume
from defocus_core.batch.journal.journal import Ledger
from defocus_core.batch.journal.record import output_fault
from defocus_core.compare.picture import SUFFIXES
from defocus_core.compare.thresholds import matches
from defocus_core.errors import InputError, UsageProblem, did_you_mean
from defocus_core.io.read_files import MALFORMED, missing
from defocus_core.io.wildcards import matching
from defocus_core.io.write_files import Folder

_RIGHT = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
_OTHER = _RIGHT | {right: left for left, right in _RIGHT.items()}
_VIEW = re.compile(rf"(?<![A-Za-z])({'|'.join(_OTHER)})(?![A-Za-z])")
_FRAME = re.compile(r"(.*?)(\d*)(\D*)", re.DOTALL)
_KINDS = ("render", "left", "right")
_VERSIONS = ("version", "renderer", "back")
RECIPE = ".recipe.json"  # suffix of the recipe of a sample, beside accepted pictures


@dataclass(frozen=True)
class FilePair:
    """A file of A and the file of B with the same name."""

    name: str  # the path relative to both folders, or the name of the lone file of B
    a: Path | None  # the reference; None if A has no such file
    b: Path | None  # the file to judge; None if B has no such file
    was: str = ""  # its name in A, if different


def find_pairs(a: Path, b: Path, *, anew: bool = False) -> list[FilePair]:
    """The pairs of two files or two folders, sorted by name; `anew`: A need not exist."""
    if anew and b.exists() and not a.exists():
        names = _pictures(b) if b.is_dir() else {b.name: b}
        return [FilePair(name, None, path) for name, path in sorted(names.items())]
    for path in (a, b):
        if not path.exists():
            raise missing(path, "file or directory")
    if a.is_dir() != b.is_dir():
        folder, file = (a, b) if a.is_dir() else (b, a)
        problem = f"is a directory but {file} is a file"
        raise InputError("wrong-type", problem, "name two files, or two directories", path=folder)
    if not a.is_dir():
        return [FilePair(b.name, a, b)]
    of_a, of_b = _pictures(a), _pictures(b)
    if not of_a and not of_b:
        known = ", ".join(sorted(suffix[1:] for suffix in SUFFIXES))
        problem = f"holds no picture, nor does {b}"
        raise InputError("empty", problem, f"name directories with files of type {known}", path=a)
    for name in of_a.keys() - of_b:
        if (main := _main_of(Path(name))) and of_a.keys() & of_b.keys() & {main.as_posix()}:
            del of_a[name]  # accepted beside another
    pairs = {n: FilePair(n, of_a.get(n), of_b.get(n)) for n in sorted(of_a | of_b)}
    lone = [
        {n: p for n in pairs.keys() - others if (p := files.get(n))}
        for files, others in ((of_a, of_b.keys()), (of_b, of_a.keys()))
    ]
    if all(lone):  # equal bytes are the same picture
        digests = [{n: blake2b(p.read_bytes()).digest() for n, p in each.items()} for each in lone]
        for old, new in _renamed(*digests):
            pairs[new] = FilePair(new, pairs.pop(old).a, pairs[new].b, old)
    return list(pairs.values())


def further(golden: Path) -> list[Path]:
    """The accepted alternatives of a golden NAME.exr that exist: NAME.1.exr, NAME.2.exr, …."""
    there = golden.parent.iterdir() if golden.parent.is_dir() else ()
    return sorted(file for file in there if _main_of(file) == golden)


def _main_of(path: Path) -> Path | None:
    """NAME.exr for its alternative NAME.1.exr; None for other names."""
    name = Path(path.stem)
    return path.with_stem(name.stem) if name.suffix[1:].isdigit() else None


def _renamed(a: Mapping[Any, Any], b: Mapping[Any, Any]) -> Iterator[tuple[Any, Any]]:
    """Pairs of a key of A and a key of B with the same value, which no other key has."""
    counts = [Counter(side.values()) for side in (a, b)]
    of_a = {value: key for key, value in a.items()}
    for key, value in sorted(b.items()):
        if all(count[value] == 1 for count in counts):
            yield of_a[value], key


def _pictures(folder: Path) -> dict[str, Path]:
    """The path of each picture below a folder, by its relative path; links are followed."""
    files = (path for _, path in matching(folder, "**"))
    return {
        path.relative_to(folder).as_posix(): path
        for path in files
        if path.suffix.lower() in SUFFIXES
    }


def partners(path: Path) -> Iterator[tuple[str, Path]]:
    """Files near A that B may show by mistake instead of A, as (name of the finding, file).

    They are the other view, other pictures of the sample, and the frames before and after.
    """
    folder, above = path.parent, path.parent.parent
    views = [path.with_stem(other_view(path.stem)), above / other_view(folder.name) / path.name]
    kinds = [above / kind / path.name for kind in _KINDS if folder.name in _KINDS]
    match = _FRAME.fullmatch(path.stem)
    assert match is not None  # it may be empty
    stem, number, rest = match.groups()
    near = [f"{int(number) + k:0{len(number)}d}" for k in (-1, 1)] if number else []
    frames = [path.with_stem(stem + frame + rest) for frame in near]
    for other in dict.fromkeys([*views, *kinds, *frames]):
        if other != path and other.is_file():
            name = f"another view or frame: {other.parent.name}/{other.name}"
            yield "left and right swapped" if other in views else name, other


def other_view(name: str) -> str:
    """The name, with its last 'left' replaced by 'right' or the reverse, if it has one."""
    *_, match = [None, *_VIEW.finditer(name)]
    if match is None:
        return name
    return name[: match.start()] + _OTHER[match[0]] + name[match.end() :]


@dataclass(frozen=True)
class RecipeChange:
    """A difference between the recipes of two batches, and the number of samples that have it."""

    # A setting like lens.fnum, ``renderer``, ``version`` or ``back``; or, like ``input color``, the
    # role of an input whose bytes differ
    what: str
    a: str  # its value in A
    b: str  # its value in B
    samples: int  # number of samples with this difference
    shared: int  # number of samples that both have

    @property
    def words(self) -> str:
        """The change, like ``lens.fnum 2 instead of 1.4 in 3 of 4 samples``."""
        many = f"in {self.samples} of {self.shared} samples"
        if self.what.startswith("input "):
            return f"other bytes of the {self.what} {many}"
        return f"{self.what} {self.b} instead of {self.a} {many}"


@dataclass(frozen=True)
class BatchPairs:
    """The pictures of two batches, and the changes of their recipes, the most frequent first."""

    pairs: list[FilePair]
    changes: list[RecipeChange]
    shared: int

    def lines(self) -> Iterator[str]:
        """Lines on the changes of recipes, or one line if there are none."""
        if self.shared and not self.changes:
            yield f"recipes: alike in all {self.shared} samples that both batches have"
        for change in self.changes:
            yield f"recipe: {change.words}"


@dataclass(frozen=True)
class Recipe:
    """The recipe of a sample, from a journal or a file beside goldens."""

    settings: Mapping[str, Any]
    version: str
    renderer: int | None
    inputs: Mapping[str, str | None]  # the hash of the bytes by role
    files: Mapping[str, str]  # relative paths of its pictures by kind
    back: str = "torch"  # back of rendering

    @property
    def made_by(self) -> str:
        """A text of everything that decides the pictures of the sample, except names."""
        return json.dumps([self.inputs, {**self.settings, "stem": ""}], sort_keys=True)

    @property
    def json(self) -> bytes:
        """The content of the recipe's file; equal recipes have equal bytes."""
        return json.dumps(asdict(self), indent=1, sort_keys=True).encode() + b"\n"


def read_recipes(folder: Path) -> dict[str, Recipe]:
    """The recipes of a batch or of its accepted goldens; empty for other folders."""
    if is_batch(folder):
        return {
            record.sample_id: Recipe(
                *(record.settings, record.version, record.renderer),
                {role: stamp.blake2b for role, stamp in record.inputs.items()},
                {kind: stamp.path for kind, stamp in record.outputs.items()},
                record.completed.back,
            )
            for record in Ledger(folder).records()
            if record.completed is not None
        }
    names = [name for name in Folder(folder).names() if name.endswith(RECIPE)]
    return {name.removesuffix(RECIPE): _read_recipe(folder, name) for name in names}


def _read_recipe(folder: Path, name: str) -> Recipe:
    try:
        values = json.loads(Folder(folder).read(name))
        sample = Recipe(**values)
        faults = [output_fault(path, sample.inputs) for path in sample.files.values()]
        tables = (sample.settings, sample.inputs, sample.files)
        if not any(faults) and all(isinstance(table, dict) for table in tables):
            return sample
    except (OSError, TypeError, AttributeError, *MALFORMED):
        pass
    remedy = "resolve the merge conflict, or remove the file: ‹accept› writes it again"
    raise InputError("damaged", "is not a recipe of a sample", remedy, path=folder / name)


def samples_of(b: Path, pairs: Sequence[FilePair]) -> dict[str, Recipe]:
    """The recipes of those samples of the folder B that have a file in the pairs, by name."""
    samples = read_recipes(b)
    names = {pair.b.relative_to(b).as_posix() for pair in pairs if pair.b is not None}
    return {name: s for name, s in samples.items() if not names.isdisjoint(s.files.values())}


def is_batch(folder: Path) -> bool:
    """Whether a folder has the journal of a batch."""
    return folder.is_dir() and any(folder.glob("journal*.jsonl"))


def are_batches(*folders: Path) -> bool:
    """Whether all folders have the journal of a batch, or accepted recipes."""
    return all(is_batch(f) or (f.is_dir() and any(f.glob(f"*{RECIPE}"))) for f in folders)


def pair_batches(a: Path, b: Path, only: Sequence[str] = ()) -> BatchPairs:
    """The pictures of two batches, paired by sample and kind.

    `only`: patterns of names; pictures that match none are left out. Empty for all pictures.
    """
    of_a, of_b = read_recipes(a), read_recipes(b)
    files_a, files_b = _files(a, of_a), _files(b, of_b)
    if not files_a and not files_b:
        problem = f"has a journal without pictures, and so has {b}"
        raise InputError("empty", problem, "name batches that made some", path=a)
    pairs = {}
    made_by = [
        {key: (key[1], of[key[0]].made_by) for key in keys}
        for of, keys in ((of_a, files_a.keys() - files_b), (of_b, files_b.keys() - files_a))
    ]
    was = {new: old for old, new in _renamed(*made_by)}
    for key in sorted({*files_a, *files_b} - {*was.values()}):
        if key in was:
            before, now = files_a[was[key]], files_b[key]
            name, old = now.relative_to(b).as_posix(), before.relative_to(a).as_posix()
            pairs[key] = FilePair(name, before, now, old)
            continue
        one, other = files_a.get(key), files_b.get(key)
        root, path = (a, one) if one is not None else (b, other)
        assert path is not None
        pairs[key] = FilePair(path.relative_to(root).as_posix(), one, other)
    chosen = chosen_pairs(sorted(pairs.values(), key=lambda pair: pair.name), only)
    names = {name for (name, _), pair in pairs.items() if pair in chosen}
    shared = sorted(of_a.keys() & of_b.keys() & names)
    counts = Counter(change for name in shared for change in _changes(of_a[name], of_b[name]))
    changes = [RecipeChange(*change, count, len(shared)) for change, count in counts.items()]
    changes.sort(key=lambda change: (-change.samples, change.what, change.b))
    return BatchPairs(chosen, changes, len(shared))


def chosen_pairs(pairs: list[FilePair], only: Sequence[str]) -> list[FilePair]:
    """The pairs whose names match one of the patterns; if there are no patterns, all pairs."""
    for pattern in only:
        if not any(matches(pair.name, pattern) for pair in pairs):
            names = [pair.name for pair in pairs]
            remedy = did_you_mean(pattern, names, f"name one like {names[0]}")
            problem = f"'{pattern}' matches no picture"
            raise UsageProblem("empty", problem, remedy, field="only")
    return [p for p in pairs if not only or any(matches(p.name, pattern) for pattern in only)]


def _files(folder: Path, samples: Mapping[str, Recipe]) -> dict[tuple[str, str], Path]:
    """The existing pictures of samples, by sample and kind."""
    return {
        (name, kind): path
        for name, sample in samples.items()
        for kind, place in sample.files.items()
        for path in [folder / place]
        if path.suffix.lower() in SUFFIXES and path.exists()
    }


def _changes(a: Recipe, b: Recipe) -> Iterator[tuple[str, str, str]]:
    """The differences between two recipes: (what, value in A, value in B)."""
    for key, was, now in resume.changed_settings(a.settings, b.settings):
        yield key, f"{was!s:.200}", f"{now!s:.200}"
    for key in _VERSIONS:
        was, now = getattr(a, key), getattr(b, key)
        if was != now:
            yield key, str(was), str(now)
    for role in sorted({*a.inputs, *b.inputs}):
        if a.inputs.get(role) != b.inputs.get(role):
            yield f"input {role}", "", ""
