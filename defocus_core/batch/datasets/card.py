"""``OUT/README.md``: the dataset card of a finished batch, for people and for Hugging Face.

It begins with the YAML metadata of dataset cards, which names the lists of the splits. A README.md
that was not written by defocus is not replaced.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path

from defocus_core.batch.datasets.sample_index import NAME, is_free
from defocus_core.errors import one_line
from defocus_core.io.write_files import written_whole
from defocus_core.request.origin import Origin
from defocus_core.system.text import note

README = "README.md"
_OWN = "---\n# Written by defocus; without this line it stays as it is.\n"
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"))
_quoted = partial(json.dumps, ensure_ascii=False)
_MARKUP = re.compile(r"[\\`*{}\[\]<>#|!~&$]")  # special characters of Markdown


def write(
    out: Path,
    origin: Origin,
    count: int,
    lists: Mapping[str, str],
    pictures: Collection[str],
    made_by: Collection[str],
) -> list[Path]:
    """Write the README.md of a data set, unless `out` has one that defocus did not write.

    Args:
        out: The folder of the data set.
        origin: Title, licence, source and citation.
        count: The number of samples.
        lists: File name of the list of samples of each split.
        pictures: Glob patterns of the picture files that `datasets` should load.
        made_by: Versions of the programs that made the samples, as text.

    Returns:
        The path of the README.md; an empty list if it was not written.
    """
    if not is_free(out, README, lambda file: file.read(len(_OWN)) == _OWN.encode()):
        note(f"{out / README}: was not written by a batch and is kept; no other is written")
        return []
    title = one_line(origin.title or "Defocused pictures")
    size = next((words for maximum, words in _SIZES if count < maximum), "n>1M")
    said = {key: _plain(text) for key, text in origin.said.items()}
    if origin.citation.lstrip().startswith("@"):  # BibTeX
        said["citation"] = f"\n\n{_fenced(origin.citation.strip(), 'bibtex')}"
    text = [
        f"pretty_name: {_quoted(title)}",
        *([f"license: {_quoted(one_line(origin.licence))}"] if origin.licence else []),
        "task_categories: [image-to-image, depth-estimation]",
        "tags: [depth-of-field, defocus, bokeh, synthetic]",
        f"size_categories: [{size}]",
        "configs:",
        "- config_name: default",
        # Without pictures, the lists are tables.
        *([f"  metadata_filenames: {_quoted([*lists.values()])}"] if pictures else []),
        "  data_files:",
        *(
            f"  - split: {_quoted(split)}\n    path: {_quoted([name, *sorted(pictures)])}"
            for split, name in lists.items()
        ),
        "---",
        f"\n# {said.pop('title', title)}\n",
        f"{count} samples, made by defocus from sharp pictures and their depth. `{NAME}` has a "
        "line for each, with its files and its lens.\n",
        *(f"Made by {_plain(words)}.\n" for words in sorted(made_by)),
        *(f"{key.capitalize()}: {told}\n" for key, told in said.items()),
    ]
    with written_whole(out / README, out) as file:
        file.write((_OWN + "\n".join(text)).encode("utf-8", "replace"))
    return [out / README]


def _plain(text: str) -> str:
    """A text in one line, with special characters of Markdown escaped."""
    return _MARKUP.sub(r"\\\g<0>", one_line(text))


def _fenced(text: str, language: str) -> str:
    """A text as a Markdown code block, with a fence longer than any run of backticks in it."""
    fence = "`" * (1 + max(2, *map(len, re.findall("`+", text)), 0))
    return f"{fence}{language}\n{text}\n{fence}"
