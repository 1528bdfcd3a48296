"""The pytest fixture ``golden``, which compares pictures of a test with accepted ones.

``golden.check(picture, like="render")`` compares an array, a tensor or a file with
``goldens/TEST_FILE/CLASS/test_name[parameters].exr`` beside the test file, or with a golden of a
given name. Alternatives, such as for another processor, are ``NAME.1.exr``, ``NAME.2.exr``, and so
on. ``pytest --golden-update`` accepts pictures that fail, ``--golden-report FILE.html`` shows them.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options ``--golden-update`` and ``--golden-report``."""
    group = parser.getgroup("defocus")
    of = "pictures that fail golden.check()"
    group.addoption("--golden-update", action="store_true", help=f"make {of} the new goldens")
    page = f"write a page of the {of}"
    group.addoption("--golden-report", metavar="FILE", type=Path, help=page)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Write the report if it is asked for, and print its path."""
    from defocus_core.reports.html import comparisons

    if (path := config.option.golden_report) is not None:
        comparisons.write_checks(_shared(config), path)
        terminalreporter.write_line(f"report of goldens: {path}")


def _shared(config: pytest.Config) -> Path:
    """A folder that all processes of a run share, which pytest cleans up."""
    base: Path = config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
    folder = (base.parent if hasattr(config, "workerinput") else base) / "defocus-goldens"
    folder.mkdir(exist_ok=True)
    return folder


@dataclass(frozen=True)
class Golden:
    """The goldens of a test, which are its accepted pictures."""

    folder: Path  # of the goldens of the test file
    update: bool  # whether pictures that fail are accepted
    shared: Path  # folder of all processes of the run: the test of each golden, failed pictures
    test: str = ""  # pytest's name of the test
    name: str = ""  # default name of a golden: class, function and parameters of the test
    _checked: set[Path] = field(default_factory=set)

    def check(
        self, picture: Any, name: str | None = None, *, like: str | None = None, **bounds: float
    ) -> None:
        """Compare a picture with its golden, and fail the test if they differ.

        Args:
            picture: an array [H, W] or [H, W, C]; a tensor [H, W], [C, H, W] or [1, C, H, W]; or
                the path of a file. Integers of 8 and 16 bits are sRGB, other numbers linear.
            name: name of the golden, unique in the test file; by default that of the test. Slashes
                make folders.
            like: the rules: ``render`` for the same program on another machine, ``encoder`` for a
                lossy codec, ``golden`` for the same program and machine. By default, no value may
                differ by more than 1e-4, or by more than one step of its number type.
            bounds: limits by metric of ``defocus compare``, like ``psnr=45``; in names,
                ``rel_rmse``, ``p999`` and ``hdr_psnr`` stand for rel-rmse, p99.9 and hdr-psnr.
        """
        from defocus_core.compare.accepting import accept_picture
        from defocus_core.compare.comparison import compare_with_goldens
        from defocus_core.compare.thresholds import rules_like
        from defocus_core.errors import InputError
        from defocus_core.reports import comparison_words
        from defocus_core.reports.html import comparisons

        __tracebackhide__ = True
        rules = rules_like(like, bounds)
        suffix = Path(picture).suffix if isinstance(picture, str | Path) else ".exr"
        name = self.name if name is None else name
        golden = self._place(name, suffix)
        try:
            records = compare_with_goldens(picture, golden, rules)
            if any(record.passes for record in records):
                return
            if self.update:
                accept_picture(self.folder, golden, picture)
                return
            comparisons.keep_check(self.shared, records, golden, self.test, picture)
            told = comparison_words.of_golden(golden, name, records, proposes=not bounds)
        except InputError as error:
            told = str(error)
        pytest.fail(told, pytrace=False)

    def _place(self, name: str, suffix: str) -> Path:
        """The path of a golden of this test below the folder of goldens; no link is followed.

        A name that is no path, that was checked before, or that another test uses is an error.
        """
        from defocus_core.errors import reason
        from defocus_core.io.write_files import Folder

        __tracebackhide__ = True
        below = f"name must be that of a file below {self.folder}, and end in no number"
        if not all(part.strip(".") for part in name.split("/")) or Path(name).suffix[1:].isdigit():
            raise ValueError(f"{below}; got '{name}'")
        try:
            place = Folder(self.folder).path(f"{name}{suffix}")
        except OSError as error:
            raise ValueError(f"{below}: {reason(error)}") from None
        if place in self._checked:
            raise ValueError(f"name must be new in the test, but {name} was checked before")
        self._checked.add(place)
        claim = self.shared / sha256(os.fsencode(place)).hexdigest()
        mine = claim.with_suffix(f".{os.getpid()}")
        mine.write_text(self.test)
        with suppress(FileExistsError):
            os.link(mine, claim)  # atomic: other processes see all of it or nothing
        mine.unlink()
        if (owner := claim.read_text()) != self.test:
            both = f"is the golden of {owner}, too; give one of both another name, or none"
            pytest.fail(f"{place}: {both}", pytrace=False)
        return place


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """The goldens of the test."""
    node, config = request.node, request.config
    parts = [each.name for each in node.listchain() if isinstance(each, pytest.Class)]
    name = "/".join(part.replace("/", "_") for part in [*parts, node.name])
    folder = Path(node.path).parent / "goldens" / Path(node.path).stem
    update = config.option.golden_update
    return Golden(folder, update, _shared(config), node.nodeid, name)
