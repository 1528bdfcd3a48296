"""The tables of a card, for Markdown and for a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from defocus_core.batch.jobs.output_kinds import KINDS

# Words and unit of each distribution, by its key.
WORDS: Mapping[str, tuple[str, str]] = {
    "coc_mean_px": ("radius of the blur, mean of a picture", "px"),
    "coc_p50_px": ("radius of the blur, median of a picture", "px"),
    "coc_p99_px": ("radius of the blur, 99th percentile", "px"),
    "focus_dioptres": ("focus", "1/m"),
    "fnumber": ("f-number", "1"),
    "focal_length_mm": ("focal length", "mm"),
    "invented_share": ("pixels with invented content (trust below 0.99)", "1"),
    "clipped_share": ("pixels whose light is clipped", "1"),
}
ENDS = ("min", "p5", "p50", "p95", "max")


@dataclass(frozen=True)
class CardTable:
    """A table of a card."""

    title: str  # what it is of; empty for the first
    heading: Sequence[str]
    rows: Sequence[Sequence[str]]


def tables_of(card: Mapping[str, Any]) -> Iterator[CardTable]:
    """The tables of a card that have rows."""
    every = (
        _kinds(card["kinds"]),
        _distributions(card["distributions"]),
        _counts("Splits, each scene in one", card["splits"]),
        _counts("Sizes in px", card["sizes"]),
        _counts("Depth was read as", card["depth"]["read_as"]),
        _counts("Depth was repaired for", card["depth"]["repaired"]),
        _counts("Warnings", card["warnings"]),
        _counts("Left out, by reason", card["failures"]),
        _counts("Quality of the rendering", card["recipe"]["quality"]),
        _counts("Versions", card["versions"]),
        _settings(card["recipe"]),
    )
    yield from (table for table in every if table.rows)


def _kinds(kinds: Mapping[str, int]) -> CardTable:
    rows = [(f"{kind}/", KINDS[kind].help, str(count)) for kind, count in kinds.items()]
    return CardTable("Folders", ("folder", "holds", "samples"), rows)


def _distributions(of: Mapping[str, Mapping[str, float]]) -> CardTable:
    rows = [(*words, *_numbers(of[key])) for key, words in WORDS.items() if key in of]
    return CardTable("Distributions over samples", ("of", "unit", *ENDS), rows)


def _counts(title: str, counts: Mapping[str, int]) -> CardTable:
    rows = [(words, str(count)) for words, count in counts.items()]
    return CardTable(title, ("", "samples"), rows)


def _settings(recipe: Mapping[str, Mapping[str, Any]]) -> CardTable:
    rows = [
        (of, name, " ".join(map(str, v)) if isinstance(v, list | tuple) else str(v))
        for of in ("reading", "outputs")
        for name, v in recipe[of].items()
    ]
    return CardTable("Settings of all samples", ("of", "setting", "value"), rows)


def _numbers(spread: Mapping[str, float] | None) -> Iterator[str]:
    return (f"{spread[end]:.4g}" if spread else "-" for end in ENDS)
