"""The card of a finished batch: ``OUT/card.json``, and ``OUT/README.md`` for people.

The head of ``README.md`` is YAML, as dataset cards of Hugging Face have it. The same records make
the same bytes: a card holds no time, and no place of a file. A README.md without the line that says
whose it is stays as it is.
"""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

from defocus_core.batch.datasets import sample_index
from defocus_core.batch.journal.record import Record, Taken
from defocus_core.errors import NoteKinds, one_line
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole
from defocus_core.request.job import SPLIT_NAME
from defocus_core.request.origin import Origin
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.text import note

JSON, _README = "card.json", "README.md"
_JSON_HEAD = b'{\n "origin": {'
_HEAD = ("---", "# Written by defocus; without this line it stays as it is.")
_README_HEAD = "".join(f"{line}\n" for line in _HEAD).encode()
NO_ORIGIN = Origin()
_UNSET: tuple[Any, ...] = (None, "", False, [], ())
_TITLE = "Defocused pictures"
Entry = Mapping[str, Any]
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))
_MARKUP = re.compile(r"[\\`*{}\[\]<>#|!~&$]")  # what Markdown takes for its own


def write(out: Path, card: Mapping[str, Any], configs: Iterable[str], index: str) -> list[Path]:
    """Write a card, each file whole or not at all, with the hash of the index that it is of."""
    as_json = (
        json.dumps({**card, "index_blake2b": index}, indent=1, ensure_ascii=False, allow_nan=False)
        + "\n"
    )
    texts = {JSON: as_json, _README: markdown(card, configs)}
    if not is_own(out, _README):
        del texts[_README]
        note(f"{out / _README}: is not of this batch, and stays; no card is written for people")
    for name, text in texts.items():
        with written_whole(out / name) as file:
            file.write(text.encode("utf-8", "replace"))
    return [out / name for name in texts]


def remove(out: Path) -> None:
    """Remove the card of OUT."""
    Folder(out).remove(JSON)
    if is_own(out, _README):
        Folder(out).remove(_README)


def read(out: Path) -> dict[str, Any]:
    """The card of OUT, with the files that it speaks of; an empty one if it cannot be read."""
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        card: dict[str, Any] = json.loads(Folder(out).read(JSON))
        if all(SPLIT_NAME.fullmatch(name) for name in card["splits"]) and (out / _README).exists():
            return card
    return {}


def is_own(out: Path, name: str = JSON) -> bool:
    """Whether a file of a card begins as ours do, or is missing."""
    head = _README_HEAD if name == _README else _JSON_HEAD
    return sample_index.is_free(out, name, lambda file: file.read(len(head)) == head)


def card_of(
    records: Iterable[Record],
    origin: Origin = NO_ORIGIN,
    see: Callable[[Entry], None] = lambda _: None,
) -> dict[str, Any]:
    """The card of a batch as plain values.

    `records`: of its journal by name, oldest first; `see`: called with the entry of each sample.
    """
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    read_as, warnings, pictures = NoteKinds(), NoteKinds(), set[bytes]()
    common: dict[str, dict[str, Any]] = {}
    for record in sample_index.joined(_counted(records, counts["failures"])):
        taken, entry = record.end, sample_index.entry_of(record, origin)
        assert isinstance(taken, Taken)  # of a sample
        pictures.add(blake2b(repr([*entry["inputs_blake2b"].values()]).encode()).digest())
        for name, words in (
            ("splits", filter(None, [entry["split"]])),
            ("kinds", [*entry["outputs"]]),
            ("sizes", [f"{entry['width']}x{entry['height']}"]),
            ("repaired", entry["depth_repaired"] or ["nothing"]),
            ("quality", [entry["quality"]]),
            ("versions", [f"defocus {entry['version']}, renderer {entry['renderer']}"]),
        ):
            counts[name].update(words)
        read_as.add(taken.depth_note.partition(";")[0])
        warnings.add(*taken.warnings)
        for of in ("reading", "outputs"):
            asked = record.settings.get(of) or {}
            shared = common.setdefault(of, dict(asked)).items()
            common[of] = {k: v for k, v in shared if asked.get(k) == v and v not in _UNSET}
        see(entry)
    ordered = {
        name: dict(sorted(each.items(), key=lambda item: (-item[1], item[0])))
        for name, each in counts.items()
    }
    return {
        "origin": origin.said,
        "samples": sum(counts["sizes"].values()),
        "pictures": len(pictures),
        **{name: ordered.get(name, {}) for name in ("splits", "kinds", "sizes")},
        "depth": {"read_as": read_as.counts, "repaired": ordered.get("repaired", {})},
        "warnings": warnings.counts,
        "failures": ordered["failures"],
        "recipe": {
            "quality": ordered.get("quality", {}),
            **{of: common.get(of, {}) for of in ("reading", "outputs")},
        },
        "versions": ordered.get("versions", {}),
    }


def _counted(records: Iterable[Record], failures: Counter[str]) -> Iterator[Record]:
    """The records that took a picture; the others are counted by reason."""
    for record in records:
        if record.taken is None:
            failures[record.end.reason or record.status] += 1
        else:
            yield record


def markdown(card: Mapping[str, Any], configs: Iterable[str] = ()) -> str:
    """A card for people."""
    size = next((words for maximum, words in _SIZES if card["samples"] < maximum), "n>1M")
    origin = {key: one_line(text) for key, text in card["origin"].items()}
    title = origin.get("title", _TITLE)
    head = [
        *_HEAD,
        f"pretty_name: {json.dumps(title, ensure_ascii=False)}",
        *(f"license: {json.dumps(text)}" for text in [origin.get("licence")] if text),
        "task_categories:",
        "- image-to-image",
        "- depth-estimation",
        "tags: [depth-of-field, defocus, bokeh, synthetic]",
        f"size_categories: [{size}]",
        *configs,
        "---",
        "",
    ]
    return "\n".join([*head, *_body(card)]) + "\n"


def _body(card: Mapping[str, Any]) -> Iterator[str]:
    origin = {key: _safe(text) for key, text in card["origin"].items()}
    yield f"# {origin.get('title', _TITLE)}"
    yield ""
    for key in ("licence", "source"):
        if key in origin:
            yield from (f"{key.capitalize()}: {origin[key]}", "")
    yield (
        f"{card['samples']} samples of {card['pictures']} pictures, made by defocus from sharp "
        "pictures and their depth. `metadata.jsonl` has a line for each sample, with its lens."
    )
    for table in tables_of(card):
        yield from ("", f"## {table.title}", "")
        yield f"| {' | '.join(table.heading)} |"
        yield "|---" * len(table.heading) + "|"
        yield from (f"| {' | '.join(map(_safe, row))} |" for row in table.rows)
    yield from ("", "## Citation", "")
    default = "Cite the sources of the pictures, and defocus by its version."
    yield origin.get("citation", default)


def _safe(words: str) -> str:
    """Words from a journal, which may come from anywhere, with signs of Markdown escaped."""
    return _MARKUP.sub(r"\\\g<0>", one_line(words))


class CardTable(NamedTuple):
    """A table of a card."""

    title: str  # what it is of; empty for the first
    heading: Sequence[str]
    rows: Sequence[Sequence[str]]


def tables_of(card: Mapping[str, Any]) -> Iterator[CardTable]:
    """The tables of a card that have rows."""
    recipe = card["recipe"]
    kinds = [(f"{kind}/", KINDS[kind].help, str(n)) for kind, n in card["kinds"].items()]
    counts = {
        "Splits, each scene in one": card["splits"],
        "Sizes in px": card["sizes"],
        "Depth was read as": card["depth"]["read_as"],
        "Depth was repaired for": card["depth"]["repaired"],
        "Warnings": card["warnings"],
        "Left out, by reason": card["failures"],
        "Quality of the rendering": recipe["quality"],
        "Versions": card["versions"],
    }
    settings = [
        (of, name, " ".join(map(str, v)) if isinstance(v, list | tuple) else str(v))
        for of in ("reading", "outputs")
        for name, v in recipe[of].items()
    ]
    every = (
        CardTable("Folders", ("folder", "holds", "samples"), kinds),
        *(
            CardTable(title, ("", "samples"), [(words, str(n)) for words, n in of.items()])
            for title, of in counts.items()
        ),
        CardTable("Settings of all samples", ("of", "setting", "value"), settings),
    )
    return (table for table in every if table.rows)
