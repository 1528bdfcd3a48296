"""A summary of comparisons in Markdown, for a comment on a pull request."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from defocus_core.compare.record import Comparison
from defocus_core.errors import printable
from defocus_core.io.write_files import require_replaceable, written_whole
from defocus_core.reports.comparison_words import number_words, place_words, summary, worst_words
from defocus_core.reports.html.comparisons import rank

BEGINNING = "<!-- defocus compare -->"
_ROWS, _PICTURES = 50, 5  # pairs that are listed, and shown as pictures
_SHOWN = ("max", "psnr", "hdr-psnr", "ssim")
_LONGEST = 240  # characters in the column of what happened


def write_markdown(
    path: Path, title: str, records: Sequence[Comparison], pairs: int | None = None
) -> None:
    """Write a table of failed pairs, the difference images of the worst, and the counts of causes.

    `pairs`: number of all pairs, if some were not compared.
    """
    failing = sorted((each for each in records if not each.passes), key=rank)
    lines = [BEGINNING, f"### {_plain(title)}", "", _plain(summary(records, pairs)) + "."]
    causes = Counter(finding.name for record in failing for finding in record.findings)
    if causes:
        said = ", ".join(f"{_plain(name)} ({number})" for name, number in causes.most_common())
        lines += ["", f"**What happened:** {said}"]
    if failing:
        lines += ["", "| picture | status | what happened | numbers |", "|---|---|---|---|"]
        lines += map(_row, failing[:_ROWS])
    if len(failing) > _ROWS:
        lines += ["", f"… and {len(failing) - _ROWS} more."]
    for record in [each for each in failing if each.worst is not None][:_PICTURES]:
        assert record.worst is not None
        worst = f"{place_words(record)}, worst at {worst_words(record.worst)}"
        lines += ["", f"**{_plain(record.name)}**: {_plain(worst)}"]
        for image in record.images:
            if image.suffix == ".png":
                place = quote(Path(os.path.relpath(image, path.parent)).as_posix())
                lines += ["", f"![difference of {_plain(record.name)}]({place})"]
    require_replaceable(path, "markdown")
    with written_whole(path) as file:
        file.write(("\n".join(lines) + "\n").encode("utf-8", "replace"))


def _row(record: Comparison) -> str:
    """The Markdown row of a pair."""
    words = ", ".join(finding.text for finding in record.findings) or record.error
    words = words or ", ".join(record.failed)
    words = words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}…"
    numbers = ", ".join(number_words(n, v) for n, v in record.metrics.items() if n in _SHOWN)
    return f"| {' | '.join(map(_plain, (record.name, record.status, words, numbers)))} |"


def _plain(text: str) -> str:
    """Text with the special characters of Markdown, links and mentions escaped."""
    return re.sub(r"[&<>|`*_\[\]\\#@~]", lambda each: f"&#{ord(each[0])};", printable(text))
