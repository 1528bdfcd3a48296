"""The pytest fixture ``golden``: pictures of a test are compared with those that were accepted.

``golden.check(image, like="render")`` compares an array, a tensor or a file with
``goldens/TEST_FILE/CLASS/test_name[parameters].exr`` beside the test, or with one of a given name.
``pytest --golden-update`` accepts what fails; goldens that no test owns are listed at the end of a
full run, and ``--golden-prune`` removes them.
``pytest --junitxml NAME.xml`` writes ``NAME.goldens.html`` too, a report to look at in a browser.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from defocus_core.compare.record import CompareSettings, Comparison
    from defocus_core.compare.thresholds import Rules

_FOLDER = "goldens"
_KEPT = pytest.StashKey[Path]()  # the folder that checks are kept in for the report
_OWNERS = pytest.StashKey[dict[Path, str]]()
_WORD = "defocus_goldens"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--golden-update`` and ``--golden-prune``."""
    group = parser.getgroup("defocus")
    text = "make pictures that fail golden.check() the new goldens"
    group.addoption("--golden-update", action="store_true", help=text)
    text = "remove goldens that no test owns, after a full run"
    group.addoption("--golden-prune", action="store_true", help=text)


def pytest_configure(config: pytest.Config) -> None:
    """Take in what tests check, in the first process."""
    given = getattr(config, "workerinput", None)
    if given is None:
        config.pluginmanager.register(_TestRun(config))
    elif _WORD in given:
        config.stash[_KEPT] = Path(given[_WORD])


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, None]:
    """Tell the first process which goldens a test looked at."""
    report = (yield).get_result()
    if "golden" in getattr(item, "fixturenames", ()):
        owners = item.config.stash.get(_OWNERS, {})
        mine = [str(place) for place, owner in owners.items() if owner == item.nodeid]
        report.goldens = (str(_folder_of(item)), mine)


class _TestRun:
    """All checks of a run: their report, and the goldens that no test looked at."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.owned: dict[Path, set[Path]] = {}
        self.unsettled: set[Path] = set()  # folders of a test that may own more than it looked at
        chosen = ("keyword", "markexpr", "lf", "deselect", "stepwise")
        self.partial = any(config.getoption(name, None) for name in chosen)
        self.partial |= any("::" in word for word in config.args)
        junit = getattr(config.option, "xmlpath", None)
        self.report = Path(junit).with_suffix(".goldens.html") if junit else None
        if self.report is not None:
            config.stash[_KEPT] = Path(tempfile.mkdtemp(prefix="defocus-goldens-"))

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Name the folder of checks to a process of pytest-xdist."""
        if self.report is not None:
            node.workerinput[_WORD] = str(self.config.stash[_KEPT])

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        """Tests were left out."""
        self.partial |= bool(items)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take in what a test looked at, in this process or another."""
        if not (told := getattr(report, "goldens", None)):
            return
        folder = Path(told[0])
        self.owned.setdefault(folder, set()).update(map(Path, told[1]))
        if not report.passed:
            self.unsettled.add(folder)

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, exitstatus: int
    ) -> None:
        """Write the report, and list or remove the goldens that no test owns."""
        prune, maxfail = map(self.config.getoption, ("--golden-prune", "maxfail"))
        lines = [] if self.report is None else self._write_report(self.report)
        if not self.partial and (exitstatus == 0 or (exitstatus == 1 and not maxfail)):
            lines += list(self._unowned(prune))
        elif prune:
            lines.append("--golden-prune: no full run, nothing is removed")
        for line in lines:
            terminalreporter.write_line(line)

    def _write_report(self, path: Path) -> list[str]:
        """Write the report of all checks, and say where it is; nothing if there were none."""
        from defocus_core.errors import InputError
        from defocus_core.reports.html import comparisons

        kept = self.config.stash[_KEPT]
        try:
            if not any(kept.iterdir()):
                return []
            comparisons.write_checks(kept, path)
        except (InputError, OSError) as error:
            return [f"no report of goldens: {error}"]
        finally:
            shutil.rmtree(kept, ignore_errors=True)
        return [f"report of goldens: {path}"]

    def _unowned(self, prune: bool) -> Iterator[str]:
        """A line for each picture that no test looked at, of this run or of no test file."""
        from defocus_core.compare.picture import SUFFIXES
        from defocus_core.io.below import Folder

        words = "was removed, as no test owns it" if prune else "no test owns this golden"
        lost = {
            each
            for root in {folder.parent for folder in self.owned}
            for each in (root.iterdir() if root.is_dir() else ())
            if not (root.parent / f"{each.name}.py").exists()
        }
        for folder in sorted({*self.owned, *lost} - self.unsettled):
            for root, _, names in () if folder.is_symlink() else os.walk(folder):
                for path in (Path(root, name) for name in sorted(names)):
                    is_picture = path.suffix.lower() in SUFFIXES and not path.is_symlink()
                    if is_picture and path not in self.owned.get(folder, ()):
                        yield f"{os.path.relpath(path)}: {words}"
                        if prune:
                            Folder(folder).remove(path.relative_to(folder).as_posix())


def _folder_of(item: Any) -> Path:
    """The folder of the goldens of a test."""
    return Path(item.path).parent / _FOLDER / Path(item.path).stem


class Golden:
    """The goldens of a test file.

    Attributes:
        folder: where they are.
        update: whether pictures are accepted.
        test: the name that pytest has for the test.
        kept: the folder that checks are kept in for a report; None if there is to be none.
        owners: the test of each golden that was looked at in this run.
        name: of a golden that is given none: class, function and parameters of the test.
    """

    def __init__(
        self,
        folder: Path,
        *,
        update: bool,
        test: str = "",
        kept: Path | None = None,
        owners: dict[Path, str] | None = None,
        name: str = "",
    ) -> None:
        self.owners: dict[Path, str] = {} if owners is None else owners
        self.folder, self.update, self.test, self.kept = folder, update, test, kept
        self.name = name
        self._checked: set[str] = set()

    def check(
        self,
        image: Any,
        name: str | None = None,
        *,
        like: str | None = None,
        fail: Sequence[str] = (),
        thresholds: str | os.PathLike[str] | None = None,
        region: tuple[int, int, int, int] | None = None,
        mask: str | os.PathLike[str] | None = None,
        ignore_region: Sequence[tuple[int, int, int, int]] = (),
        ignore_mask: str | os.PathLike[str] | None = None,
        tolerate_edges: bool = False,
        **bounds: float,
    ) -> None:
        """Compare an image with its golden, and fail the test if it is not like it.

        Args:
            image: an array [H, W] or [H, W, C]; a tensor [H, W], [C, H, W] or [1, C, H, W]; or the
                path of a file. Arrays and tensors are linear.
            name: of the golden, unique in the test file; may hold slashes. Without one it is that
                of the test: its class, function and parameters.
            like: a set of rules: ``render`` (the same program on another machine), ``encoder`` (a
                lossy codec) or ``golden`` (the same program and machine).
            fail: rules like ``found:clipped`` or ``psnr<45``, besides bounds.
            thresholds: a file of thresholds; bounds and rules win over it.
            region: x, y, width and height in px of what is compared.
            mask: a file that is not 0 where pixels are compared.
            ignore_region: parts that are not compared, each as a region.
            ignore_mask: a file that is not 0 where pixels are not compared.
            tolerate_edges: whether pixels at edges may differ as far as their neighbours do.
            bounds: metrics of ``defocus compare`` with what is just allowed, like ``psnr=45`` or
                ``max=0.02``; rel_rmse, p999 and hdr_psnr for rel-rmse, p99.9 and hdr-psnr.
                By default, no value may differ by more than 1e-4.

        Raises:
            ValueError: the image has another shape, or values that 32 bits cannot hold; a metric is
                not known, or its bound is NaN; a rule makes no sense; or the name is empty, was
                checked in this test before, or leads out of the folder.
            InputError: the file of thresholds cannot be read.
            UsageProblem: a region is not within the picture, or the file makes no sense.
        """
        from defocus_core.compare.picture import planes_of
        from defocus_core.compare.record import EXTRA, CompareSettings, Comparison
        from defocus_core.compare.selection import CropRegion
        from defocus_core.reports.comparison_words import line

        __tracebackhide__ = True
        name = self.name if name is None else name
        rules = _rules(name, bounds, like, fail, thresholds)
        settings = CompareSettings(
            region=None if region is None else CropRegion(*region),
            mask=None if mask is None else Path(mask),
            ignore_region=tuple(CropRegion(*each) for each in ignore_region),
            ignore_mask=None if ignore_mask is None else Path(ignore_mask),
            tolerate_edges=tolerate_edges,
            flip=any(each.metric.startswith("flip") for each in rules.fail),
        )
        source = Path(image) if isinstance(image, str | Path) else None
        if not all(part.strip(".") for part in name.split("/")):
            raise ValueError(f"name must be that of a file below {self.folder}, got '{name}'")
        golden = self._place(f"{name}{source.suffix if source else '.exr'}")
        picture = planes_of(image) if source is None else source
        if not golden.exists():
            if self.update:
                _accept(self.folder, golden, picture)
                return
            self._keep(Comparison(name, None, None, EXTRA), golden, picture)
            lacks = "there is no such golden; make it with pytest --golden-update"
            pytest.fail(f"{golden}: {lacks}", pytrace=False)
        record = self._compared(golden, picture, name, rules, settings)
        if self.update:
            if not record.passes:  # what passes stays, byte for byte
                _accept(self.folder, golden, picture)
            return
        self._keep(record, golden, picture)
        if not record.passes:
            told = [line(replace(record, proposal=""))]
            if record.proposal and not bounds:
                told.append(f"{record.proposal.replace('>', '=')} lets it pass")
            told.append(f"--golden-update makes it the golden {golden}")
            pytest.fail("\n".join(told), pytrace=False)

    def _compared(
        self, golden: Path, image: Any, name: str, rules: Rules, settings: CompareSettings
    ) -> Comparison:
        """The record of a file, or of channels, and its golden."""
        from defocus_core.compare.comparison import compare_pictures
        from defocus_core.compare.picture import of_planes, read_picture
        from defocus_core.compare.record import UNREADABLE, Comparison
        from defocus_core.errors import InputError

        __tracebackhide__ = True
        try:
            picture = read_picture(image) if isinstance(image, Path) else of_planes(image, name)
            aim = read_picture(golden)
            if not isinstance(image, Path):  # an array has neither metadata nor a codec
                types = {n: kind for n, kind in picture.types.items() if n in aim.types}
                aim = replace(aim, metadata={}, layout={}, types={**aim.types, **types})
            return compare_pictures(name, aim, picture, rules, settings)[0]
        except InputError as error:
            if not self.update:
                pytest.fail(str(error), pytrace=False)
            return Comparison(name, golden, None, UNREADABLE)

    def _place(self, name: str) -> Path:
        """The path of a golden, which lies below the folder, no link followed."""
        from defocus_core.errors import reason
        from defocus_core.io.below import Folder

        __tracebackhide__ = True
        if name in self._checked:
            raise ValueError(f"name must be new in the test, but {name} was checked before")
        self._checked.add(name)

        try:
            place = Folder(self.folder).path(name)
        except OSError as error:
            raise ValueError(
                f"name must be that of a file below {self.folder}: {reason(error)}"
            ) from None
        owner = self.owners.setdefault(place, self.test)
        if self.update and owner != self.test:
            both = f"is the golden of {owner}, too; give one of both another name, or none"
            pytest.fail(f"{place}: {both}", pytrace=False)
        return place

    def _keep(self, record: Comparison, golden: Path, picture: Any) -> None:
        """Keep a check for the report, by the path of its golden."""
        from defocus_core.reports.html import comparisons

        if self.kept is not None:
            name = os.path.relpath(golden)
            comparisons.keep_check(self.kept, replace(record, name=name), self.test, picture)


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """The goldens of the test file."""
    node, config = request.node, request.config
    parts = [each.name for each in node.listchain() if isinstance(each, pytest.Class)]
    return Golden(
        _folder_of(node),
        update=bool(config.getoption("--golden-update")),
        test=node.nodeid,
        kept=config.stash.get(_KEPT, None),
        owners=config.stash.setdefault(_OWNERS, {}),
        name="/".join(part.replace("/", "_") for part in [*parts, node.name]),
    )


def _rules(
    name: str,
    bounds: Mapping[str, float],
    like: str | None,
    fail: Sequence[str],
    thresholds: str | os.PathLike[str] | None,
) -> Rules:
    """The rules of a check, which add to those it is to be like."""
    from defocus_core.compare.metrics import METRICS
    from defocus_core.compare.thresholds import (
        PRESETS,
        ROUNDING,
        Rule,
        Rules,
        read_thresholds,
        rule,
    )
    from defocus_core.request.quantities import QuantityError

    __tracebackhide__ = True
    if like is not None and like not in PRESETS:
        raise ValueError(f"like must be one of {', '.join(PRESETS)}, got {like}")
    rules = []
    for key, bound in bounds.items():
        metric = key.replace("p999", "p99.9").replace("_", "-")
        if metric not in METRICS:
            raise ValueError(f"bounds must be metrics ({', '.join(METRICS)}), got {key}")
        if math.isnan(bound):
            raise ValueError(f"the bound of {key} must be a number, got NaN: it lets all pass")
        sign = "<" if METRICS[metric].better == "high" else ">"
        rules.append(Rule(metric, sign, float(bound), f"{metric}{sign}{bound:g}"))
    try:
        rules += [rule(text) for text in ([fail] if isinstance(fail, str) else fail)]
    except QuantityError as error:
        raise ValueError(f"fail: {error.problem}; {error.remedy}") from None
    default = Rules(fail=(ROUNDING,)) if like is None else PRESETS[like]
    given = [*default.fail, *rules] if rules and like is not None else rules
    file = None if thresholds is None else Path(thresholds)
    return read_thresholds(file, given, default=default).of(name)


def _accept(folder: Path, golden: Path, picture: Any) -> None:
    """Make a file, or channels, the golden."""
    from defocus_core.io.exr.writing import write_exr
    from defocus_core.io.safe_files import written_together, written_whole

    with written_together(folder):
        if not isinstance(picture, Path):
            write_exr(golden, picture, {})
            return
        with written_whole(golden) as file:
            file.write(picture.read_bytes())
