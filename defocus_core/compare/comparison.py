"""The comparison of a pair: reading, structure, pixels, metrics, findings and verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from filecmp import cmp
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from defocus_core.compare import verdict
from defocus_core.compare.findings.choice import diagnose
from defocus_core.compare.findings.table import Finding, is_place
from defocus_core.compare.findings.tone import clipped_light, lost_channels
from defocus_core.compare.flip import measure_flip
from defocus_core.compare.metrics import equal_metrics, measure
from defocus_core.compare.pairing import FilePair, further
from defocus_core.compare.picture import (
    UNDECODED,
    DecodedPicture,
    as_shown,
    in_linear_light,
    of_planes,
    planes_of,
    read_picture,
)
from defocus_core.compare.pixels import Pixels, count_nonfinite
from defocus_core.compare.record import (
    DIFFERENT,
    EXTRA,
    MISSING,
    SAME,
    UNREADABLE,
    CompareSettings,
    Comparison,
    Worst,
)
from defocus_core.compare.selection import CropRegion, anti_aliased, read_mask
from defocus_core.compare.structure import compare_structure, of_another_size
from defocus_core.compare.thresholds import OVER, PRESETS, Rule, Rules, read_thresholds, rule
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.quantities import QuantityError
from defocus_core.system.text import counted


def compare_pair(
    pair: FilePair, rules: Rules, settings: CompareSettings
) -> tuple[Comparison, Pixels | None]:
    """Compare two files.

    Returns the record, and the compared pixels; None instead of pixels if they were not compared.
    """
    blank = Comparison(pair.name, pair.a, pair.b)
    if pair.a is None or pair.b is None:
        return replace(blank, status=MISSING if pair.b is None else EXTRA), None
    try:
        a = read_picture(pair.a)
        same = cmp(pair.a, pair.b, shallow=False)
        b = replace(a, path=pair.b) if same else read_picture(pair.b)
        record, pixels = compare_pictures(pair.name, a, b, rules, settings)
        for other in further(pair.a) if record.status == DIFFERENT and not pair.was else ():
            if (pair.b.parent / other.name).exists():
                continue  # of a sequence
            again = compare_pictures(pair.name, read_picture(other), b, rules, settings)
            if again[0].passes:
                return replace(again[0], notes=(*again[0].notes, f"as {other.name}")), again[1]
        if pair.was:
            renamed = Finding("renamed", f"renamed from {pair.was}", {"was": pair.was})
            record = replace(record, status=DIFFERENT, findings=(renamed, *record.findings))
        return record, pixels
    except InputError as error:
        if pair.b.suffix.lower() in UNDECODED and cmp(pair.a, pair.b, shallow=False):
            return replace(blank, status=SAME, notes=("not decoded, the same bytes",)), None
        return replace(blank, status=UNREADABLE, error=str(error)), None


def compare_pictures(
    name: str, a: DecodedPicture, b: DecodedPicture, rules: Rules, settings: CompareSettings
) -> tuple[Comparison, Pixels | None]:
    """Compare two decoded pictures, with the results of `compare_pair`."""
    with np.errstate(all="ignore"):  # NaN and infinity are found explicitly
        record = Comparison(name, a.path, b.path, DIFFERENT, (a.width, a.height))
        a, b = (_of_channels(each, rules) for each in (a, b))
        record, common, strict = compare_structure(record, a, b, settings, ruled=bool(rules.fail))
        if not common:
            return replace(record, findings=(*record.findings, *of_another_size(a, b))), None
        if (a.gamma, a.associated) != (b.gamma, b.associated):
            a, b = in_linear_light(a), in_linear_light(b)
        pixels, corner = _pixels(a, b, common, settings)
        if rules.visible_only:
            pixels, unseen = pixels.visible()
            said = [f"other colours in {counted(unseen, 'pixel')} where A is 0"] if unseen else []
            record = replace(record, notes=(*record.notes, *said))
        if rules.to_a_step:
            pixels = pixels.beyond_a_step({n: {a.types[n], b.types[n]} for n in common})
        rules = verdict.of_small_values(rules, pixels)
        judged = _judged(record, pixels, corner, (a, b), rules, settings, strict=strict)
        return judged, pixels


def _of_channels(picture: DecodedPicture, rules: Rules) -> DecodedPicture:
    """The picture, restricted to the channels to compare."""
    names = [name for name in picture.planes if rules.compares(name)]
    if not names:
        problem = f"has only {', '.join(picture.planes)}, and all are left out"
        raise InputError("no-such-channel", problem, "leave out fewer channels", path=picture.path)
    samples = {n: v for n, v in picture.samples.items() if not n or n in names}
    planes = {name: picture.planes[name] for name in names}
    types = {name: picture.types[name] for name in names}
    return replace(picture, planes=planes, types=types, samples=samples)


def _pixels(
    a: DecodedPicture, b: DecodedPicture, names: Sequence[str], settings: CompareSettings
) -> tuple[Pixels, tuple[int, int]]:
    """The pixels to compare, and the column and row of the first one in the picture."""
    size = (a.height, a.width)
    cut = (slice(None), slice(None)) if settings.region is None else settings.region.cut(size)
    selected = np.ones(size, bool) if settings.mask is None else read_mask(settings.mask, size)
    for region in settings.ignore_region:
        selected[region.cut(size, "ignore_region")] = False
    if settings.ignore_mask is not None:
        selected &= ~read_mask(settings.ignore_mask, size, empty=True)
    old, new = (tuple(side.planes[name][cut] for name in names) for side in (a, b))
    selected = selected[cut]
    if settings.tolerate_edges:
        selected = selected & ~anti_aliased(old, new)
    if not selected.any():
        chosen = settings.mask or settings.ignore_mask
        of = "picture" if settings.region is None else f"region {settings.region}"
        problem = f"leaves no pixel of the {of} to compare"
        remedy = "give masks and regions that leave some"
        raise InputError("empty", problem, remedy, path=chosen or a.path)
    pixels = Pixels(tuple(names), old, new, a.gamma, None if selected.all() else selected)
    return pixels, (cut[1].start or 0, cut[0].start or 0)


def _judged(
    record: Comparison,
    pixels: Pixels,
    corner: tuple[int, int],
    sides: tuple[DecodedPicture, DecodedPicture],
    rules: Rules,
    settings: CompareSettings,
    *,
    strict: bool,
) -> Comparison:
    """The record, completed by metrics, findings and the verdict.

    `corner`: column and row of the first compared pixel in the picture. `strict`: whether B is
    different whatever the rules say.
    """
    nonfinite = count_nonfinite(pixels, corner)
    differing = any(pixels.differences.largest.values())
    metrics: Mapping[str, float] = equal_metrics(pixels)
    if differing:
        metrics = measure(pixels, over=rules.over, asked=rules.asked or None)
    if settings.flip:
        metrics = {**metrics, **measure_flip(pixels)}
    findings, causes = [*record.findings, *nonfinite.findings], None
    if differing:
        findings += [*lost_channels(pixels), *clipped_light(pixels)]
        strict |= any(finding.name == "empty" for finding in findings)
        found = [finding.name for finding in findings]
        asked = verdict.asks_for_cause(rules, found, pixels)
        suspect = asked or verdict.is_suspect(rules, metrics, found)
        if asked or (settings.diagnose and suspect):
            named = {name.split(" at ")[0] for name in found}
            causes = diagnose(pixels, *sides, corner)
            findings += [cause for cause in causes if cause.name.split(" at ")[0] not in named]
        if suspect and rules.asked:
            metrics = {**measure(pixels, over=rules.over), **metrics}
    overlooked = verdict.overlooked(rules, pixels)
    of = ", ".join(overlooked)
    told = [f"other values in {of}, which no rule looks at"] if overlooked else []
    strict |= nonfinite.apart is not None or bool(overlooked)
    record = replace(
        record,
        encoding={1.0: "linear", None: "sRGB"}.get(pixels.gamma, "power"),
        findings=tuple(findings),
        metrics=metrics,
        nonfinite=nonfinite,
        notes=(*record.notes, *nonfinite.notes(), *told),
    )
    record = verdict.judge(record, rules, differs=differing, strict=strict)
    unexplained = causes is not None and all(is_place(finding.name) for finding in findings)
    if record.status == DIFFERENT and unexplained and not strict:
        record = replace(record, proposal=verdict.proposal(rules, metrics))
    return _placed(record, pixels, corner) if differing or nonfinite.apart is not None else record


def _placed(record: Comparison, pixels: Pixels, corner: tuple[int, int]) -> Comparison:
    """The record, completed by the worst pixel and the rectangle of the pixels that differ."""
    bad = pixels.greatest > 0
    row, column = np.unravel_index(int(pixels.greatest.argmax()), pixels.shape)
    assert record.nonfinite is not None
    if record.nonfinite.apart is not None:
        bad |= record.nonfinite.apart
        row, column = np.argwhere(record.nonfinite.apart)[0]
    rows, columns = np.flatnonzero(bad.any(axis=1)), np.flatnonzero(bad.any(axis=0))
    (x, y), top, left = corner, int(rows[0]), int(columns[0])
    a, b = (
        {n: float(plane[row, column]) for n, plane in zip(pixels.names, side, strict=True)}
        for side in (pixels.a, pixels.b)
    )
    return replace(
        record,
        differing=int(np.count_nonzero(bad)),
        window=(x + left, y + top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1),
        worst=Worst(x + int(column), y + int(row), a, b),
        channels=pixels.differences.largest,
    )


def compare_images(
    a: str | PathLike[str] | ArrayLike,
    b: str | PathLike[str] | ArrayLike,
    *,
    fail: Sequence[str] = (),
    warn: Sequence[str] = (),
    over: float = OVER,
    region: tuple[int, int, int, int] | None = None,
    mask: str | PathLike[str] | None = None,
    flip: bool = False,
    metadata: bool = False,
    diagnose: bool = True,
    like: str | None = None,
) -> Comparison:
    """Compare a picture with a reference, and find the cause of differences.

    Without rules in `fail`, all values must be equal. Another size or channel, and NaN or infinity
    on one side only, are never the same.

    Args:
        a: The reference: a file of colour or of a map; an array [H, W] or [H, W, C], linear; or a
            tensor [H, W], [C, H, W] or [1, C, H, W].
        b: The picture to judge, likewise.
        fail: Rules like ``psnr<45``: b fails if it meets one.
        warn: Rules that only give a warning.
        over: The difference above which the metric ``share`` counts a pixel.
        region: x, y, width and height in px of the rectangle to compare.
        mask: A file that is not 0 where pixels are compared.
        flip: Whether to measure FLIP, with ``defocus[flip]``.
        metadata: Whether differing metadata fails, too.
        diagnose: Whether to search the cause of a difference.
        like: A set of rules, if none are given: ``render`` (the same program on another machine),
            ``encoder`` (a lossy codec) or ``golden`` (the same program and machine).

    Returns:
        The record: ``status`` (same, warning or different), ``passes``, ``metrics`` by name (max,
        psnr, …), ``findings`` (causes, each with ``name``, ``text`` and ``values``), the ``worst``
        pixel, the ``window`` of all pixels that differ, and more.

    Raises:
        InputError: A file cannot be read, or the mask is of another size.
        UsageProblem: A rule is invalid, or the region is not within the picture.
        ValueError: An array is not a picture.
    """
    if like is not None and like not in PRESETS:
        raise UsageProblem(
            "unknown-name", f"'{like}' is not known", f"name {', '.join(PRESETS)}", field="like"
        )
    given = _rules("fail", fail), _rules("warn", warn), over
    rules = read_thresholds(None, *given, Rules() if like is None else PRESETS[like]).rules_of("")
    settings = CompareSettings(
        region=None if region is None else CropRegion(*region),
        mask=None if mask is None else Path(mask),
        flip=flip,
        metadata=metadata,
        diagnose=diagnose,
    )
    one, other = _picture(a, "a"), _picture(b, "b")
    return compare_pictures(other.path.name, one, other, rules, settings)[0]


def compare_with_goldens(picture: Any, golden: Path, rules: Rules) -> list[Comparison]:
    """Records like those of `compare_images`: the picture compared with each of its goldens.

    Goldens are `golden`, if it exists, and its accepted alternatives NAME.1.exr, NAME.2.exr, …
    """
    new, kind = _picture(picture, golden.stem), f"{getattr(picture, 'dtype', '')}".split(".")[-1]
    records = []
    for file in (*[golden] * golden.exists(), *further(golden)):
        mine, aim = new, read_picture(file)
        if kind:  # an array has neither metadata nor a codec
            aim = replace(aim, metadata={}, layout={}, types=dict.fromkeys(aim.types, kind))
            mine = replace(new, types=dict.fromkeys(new.types, kind))
        if kind.startswith("uint"):
            mine, aim = as_shown(mine), as_shown(aim)
        settings = CompareSettings(flip=any("flip" in each.metric for each in rules.fail))
        records.append(compare_pictures(golden.name, aim, mine, rules, settings)[0])
    return records


def _picture(image: Any, name: str) -> DecodedPicture:
    if isinstance(image, str) or hasattr(image, "__fspath__"):
        return read_picture(Path(image))
    return of_planes(planes_of(image), name)


def _rules(field: str, texts: Sequence[str]) -> tuple[Rule, ...]:
    texts = [texts] if isinstance(texts, str) else texts
    try:
        return tuple(map(rule, texts))
    except QuantityError as error:
        raise UsageProblem("no-rule", error.problem, error.remedy, field=field) from None
