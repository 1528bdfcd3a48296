"""The card of a finished batch: ``OUT/card.json``, and ``OUT/card.md`` for people.

The head of ``card.md`` is YAML, as dataset cards of Hugging Face have it. The same records make the
same bytes: a card holds no time, and no place of a file.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import quantiles
from typing import Any

from defocus_cli.dataset import sample_index
from defocus_cli.formats.kinds import KINDS
from defocus_cli.lenses import radius_set
from defocus_cli.system.safe_files import written_whole

NAMES = ("card.json", "card.md")
Record = Mapping[str, Any]
# Rows of the table of distributions: key, words, unit, and its value of a line of the index.
_ROWS: tuple[tuple[str, str, str, Callable[[Record], Any]], ...] = (
    ("coc_mean_px", "radius of the blur, mean of a picture", "px", lambda e: e["coc_mean_px"]),
    ("coc_p50_px", "radius of the blur, median of a picture", "px", lambda e: e["coc_p50_px"]),
    ("coc_p99_px", "radius of the blur, 99th percentile", "px", lambda e: e["coc_p99_px"]),
    ("focus_dioptres", "focus", "1/m", lambda e: e["lens"]["focus_dioptres"]),
    ("fnumber", "f-number", "", lambda e: e["lens"]["fnumber"]),
    ("focal_length_mm", "focal length", "mm", lambda e: e["lens"]["focal_length_mm"]),
    (
        "invented_share",
        "pixels with invented content (trust below 0.99)",
        "",
        lambda e: e["invented_share"],
    ),
    ("clipped_share", "pixels whose light is clipped", "", lambda e: e["clipped_share"]),
)
_ENDS = ("min", "p5", "p50", "p95", "max")
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))
_PLAIN = re.compile(r"[^\w .,:;()/+<>=%°×–-]")  # what Markdown or YAML could take for its own


def write(out: Path, card: Mapping[str, Any]) -> list[Path]:
    """Write a card, each file whole or not at all.

    Args:
        out: the folder of the batch.
        card: from `card_of`.

    Raises:
        InputError: a file cannot be written.
    """
    texts = (json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False) + "\n", markdown(card))
    paths = [out / name for name in NAMES]
    for path, text in zip(paths, texts, strict=True):
        with written_whole(path) as file:
            file.write(text.encode("utf-8", "replace"))
    return paths


def card_of(records: Sequence[Record]) -> dict[str, Any]:
    """The card of a batch as plain values.

    Args:
        records: of its journal, oldest first.
    """
    entries = list(sample_index.entries(records))
    ids = {entry["sample_id"] for entry in entries}
    done = [r for r in records if r["status"] == "ok" and r["sample_id"] in ids]
    failed = [r for r in records if r["status"] != "ok"]
    kinds = (kind for entry in entries for kind in entry["outputs"])
    sizes = (f"{entry['width']}x{entry['height']}" for entry in entries)
    repairs = [(r.get("depth_repair") or {}).get("kinds", []) for r in done]
    return {
        "samples": len(entries),
        "pictures": len({tuple(entry["inputs_blake2b"].values()) for entry in entries}),
        "splits": _counts(entry["split"] for entry in entries if entry["split"]),
        "kinds": _counts(kinds),
        "sizes": _counts(sizes),
        "distributions": {
            key: distribution
            for key, _, _, value in _ROWS
            if (distribution := _spread(map(value, entries)))
        },
        "match": _match(done),
        "depth": {
            "read_as": _counts(_alike(record["depth_note"].partition(";")[0]) for record in done),
            "repaired": _counts(kind for each in repairs for kind in each or ["nothing"]),
        },
        "warnings": _counts(_alike(w) for record in done for w in record["warnings"]),
        "failures": _counts(record["reason"] or record["status"] for record in failed),
        "recipe": {
            "quality": _counts(entry["quality"] for entry in entries),
            "reading": _common(record["settings"].get("reading") for record in done),
            "outputs": _common(record["settings"].get("outputs") for record in done),
        },
        "versions": _counts(f"defocus {e['version']}, renderer {e['renderer']}" for e in entries),
    }


def _match(done: Iterable[Record]) -> dict[str, Any]:
    """By measure of radii what the set matched asked for and what was reached; empty without."""
    pairs = [(r["lens"]["radii_px"], r["measures"] or {}) for r in done if "radii_px" in r["lens"]]
    if not pairs:
        return {}
    return {
        name: {
            "asked": _spread(asked[which] for asked, _ in pairs),
            "reached": _spread(reached.get(name) for _, reached in pairs),
        }
        for which, name in enumerate(radius_set.MEASURES)
    }


def match_words(card: Mapping[str, Any]) -> str:
    """How near the radii are to those of the set matched, on the mean; empty without one."""
    words = []
    for key, (_, name, *_) in zip(radius_set.MEASURES, _ROWS, strict=False):
        of = card["match"].get(key) or {}
        if of.get("asked") and of.get("reached"):
            asked, reached = of["asked"]["mean"], of["reached"]["mean"]
            words.append(f"{name.rpartition(', ')[2]} {reached:.3g} px for {asked:.3g} px")
    return ", ".join(words)


def _counts(words: Iterable[str]) -> dict[str, int]:
    """How often each occurs, the commonest first."""
    return dict(sorted(Counter(words).items(), key=lambda item: (-item[1], item[0])))


def _alike(note: str) -> str:
    """A note without its numbers, so that those of many pictures are alike."""
    return re.sub(r"\d[\d.,]*", "N", note)


def _spread(values: Iterable[Any]) -> dict[str, float] | None:
    """Ends and percentiles of numbers; None without any."""
    numbers = sorted(float(v) for v in values if v is not None and math.isfinite(v))
    if not numbers:
        return None
    parts = quantiles(numbers, n=20, method="inclusive") if len(numbers) > 1 else numbers * 19
    found = (numbers[0], parts[0], parts[9], parts[18], numbers[-1])
    return {**dict(zip(_ENDS, found, strict=True)), "mean": sum(numbers) / len(numbers)}


def _common(settings: Iterable[Mapping[str, Any] | None]) -> dict[str, Any]:
    """What all of some settings have in common, without what is not set."""
    every = [each or {} for each in settings]
    first = every[0] if every else {}
    shared = {k: v for k, v in first.items() if all(each.get(k) == v for each in every)}
    return {k: v for k, v in shared.items() if v not in (None, "", False, [], ())}


def markdown(card: Mapping[str, Any]) -> str:
    """A card for people.

    Args:
        card: from `card_of`.
    """
    size = next((words for most, words in _SIZES if card["samples"] < most), "n>1M")
    head = [
        "---",
        "pretty_name: Defocused pictures",
        "task_categories:",
        "- image-to-image",
        "- depth-estimation",
        "tags: [depth-of-field, defocus, bokeh, synthetic]",
        f"size_categories: [{size}]",
        "---",
        "",
    ]
    return "\n".join([*head, *_body(card)]) + "\n"


def _body(card: Mapping[str, Any]) -> list[str]:
    splits = ", ".join(f"{name} {count}" for name, count in card["splits"].items())
    lines = [
        "# Defocused pictures",
        "",
        f"{card['samples']} samples of {card['pictures']} pictures, made by defocus from sharp "
        "pictures and their depth. `metadata.jsonl` has a line for each sample, with its lens.",
        *(["", f"Splits: {splits}; a scene is in one of them."] if splits else []),
        "",
        "| folder | holds | samples |",
        "|---|---|---|",
        *(f"| `{kind}/` | {KINDS[kind].help} | {n} |" for kind, n in card["kinds"].items()),
        "",
        "## Distributions over samples",
        "",
        "| of | unit | " + " | ".join(_ENDS) + " |",
        "|---" * (len(_ENDS) + 2) + "|",
    ]
    for key, words, unit, _ in _ROWS:
        if key in card["distributions"]:
            numbers = (f"{card['distributions'][key][end]:.4g}" for end in _ENDS)
            lines.append(f"| {words} | {unit or '1'} | {' | '.join(numbers)} |")
    lines += _match_lines(card["match"])
    tables = (
        ("Sizes in px", card["sizes"]),
        ("Depth was read as", card["depth"]["read_as"]),
        ("Depth was repaired for", card["depth"]["repaired"]),
        ("Warnings", card["warnings"]),
        ("Left out, by reason", card["failures"]),
        ("Quality of the rendering", card["recipe"]["quality"]),
        ("Versions", card["versions"]),
    )
    for title, counts in tables:
        if counts:
            lines += ["", f"## {title}", ""]
            lines += [f"- {_safe(words)}: {count}" for words, count in counts.items()]
    recipe = {key: card["recipe"][key] for key in ("reading", "outputs") if card["recipe"][key]}
    if recipe:
        lines += ["", "## Settings of all samples", ""]
        lines += [f"- {key}: {_safe(_words(values))}" for key, values in recipe.items()]
    return [
        *lines,
        "",
        "## Citation",
        "",
        "Cite the sources of the pictures, and defocus by its version.",
    ]


def _match_lines(match: Mapping[str, Any]) -> list[str]:
    """The radii of the set matched beside those reached."""
    if not match:
        return []
    lines = ["", "## Radii of the set matched, in px", ""]
    lines += ["| of | | " + " | ".join(_ENDS) + " |", "|---" * (len(_ENDS) + 2) + "|"]
    for key, words, *_ in _ROWS:
        for which, spread in match.get(key, {}).items():
            numbers = (f"{spread[end]:.4g}" if spread else "-" for end in _ENDS)
            lines.append(f"| {words} | {which} | {' | '.join(numbers)} |")
    return lines


def _words(values: Mapping[str, Any]) -> str:
    """Settings in one line."""
    return ", ".join(
        f"{name} {' '.join(map(str, v)) if isinstance(v, list | tuple) else v}"
        for name, v in values.items()
    )


def _safe(words: str) -> str:
    """Words from a journal, which may come from anywhere, without signs of Markdown."""
    return _PLAIN.sub(" ", words)
