"""The record of a comparison, from which reports are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from defocus_core.compare.findings.table import Finding
from defocus_core.compare.pixels import Nonfinite
from defocus_core.compare.selection import CropRegion

# Statuses of a pair, the worst last.
SAME, WARNING, DIFFERENT, MISSING, EXTRA, UNREADABLE = STATUSES = (
    *("same", "warning", "different", "missing", "extra", "unreadable"),
)
PASSING = (SAME, WARNING)


@dataclass(frozen=True)
class CompareSettings:
    """The settings of comparisons."""

    region: CropRegion | None = None  # the part to compare; None for all
    mask: Path | None = None  # a file that is not 0 at compared pixels
    ignore_region: tuple[CropRegion, ...] = ()  # parts to ignore
    ignore_mask: Path | None = None  # a file that is not 0 at ignored pixels
    tolerate_edges: bool = False  # whether anti-aliased pixels may differ
    flip: bool = False  # whether to measure FLIP
    metadata: bool = False  # whether differing metadata makes a picture different
    ignore_metadata: tuple[str, ...] = ()  # patterns of names of attributes that may differ
    # whether to search the cause of a difference even if no rule needs it
    diagnose: bool = True


@dataclass(frozen=True)
class Worst:
    """The worst pixel: its column and row in the picture, and its values by channel."""

    x: int
    y: int
    a: Mapping[str, float]
    b: Mapping[str, float]


@dataclass(frozen=True)
class Comparison:
    """The results of a pair."""

    name: str
    a: Path | None  # None if it is missing
    b: Path | None
    status: str = SAME  # one of `STATUSES`
    size: tuple[int, int] | None = None  # width and height of A
    encoding: str = ""  # encoding of values: ``linear``, ``sRGB``, or ``power`` for a power law
    findings: tuple[Finding, ...] = ()  # structure first
    metrics: Mapping[str, float] = field(default_factory=dict)  # by name
    channels: Mapping[str, float] = field(default_factory=dict)  # greatest difference of each
    differing: int = 0  # number of pixels that differ
    window: tuple[int, int, int, int] | None = None  # x, y, width, height of all that differ
    worst: Worst | None = None
    nonfinite: Nonfinite | None = None
    failed: tuple[str, ...] = ()  # rules that made it fail
    warned: tuple[str, ...] = ()  # rules that made it a warning
    unmeasured: tuple[str, ...] = ()  # rules to fail whose metric it does not have
    notes: tuple[str, ...] = ()  # differences that change no pixel
    metadata: tuple[str, ...] = ()  # attributes that differ
    proposal: str = ""  # a rule by which the pair would pass; empty if no rule is proposed
    error: str = ""  # why a file could not be read
    images: tuple[Path, ...] = ()  # difference images that were written

    @property
    def acceptable(self) -> bool:
        """Whether the file of B may replace that of A."""
        return self.status in (DIFFERENT, EXTRA) and self.b is not None

    @property
    def renamed(self) -> bool:
        """Whether the file of B is that of A under another name."""
        return any(finding.name == "renamed" for finding in self.findings)

    @property
    def passes(self) -> bool:
        """Whether B passes."""
        return self.status in PASSING
