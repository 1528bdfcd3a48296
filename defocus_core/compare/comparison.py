"""One pair compared: its metrics and findings, and the verdict.

Without rules, B is the same if all values are equal over the display window; −0 equals 0, and NaN
equals NaN. With rules to fail, the rules decide about values. Another size, another set of
channels, and NaN or infinity on one side only are never the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from filecmp import cmp
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from defocus_core.compare.findings.choice import diagnose
from defocus_core.compare.findings.finding import Finding, is_place
from defocus_core.compare.findings.tone import clipped_light, lost_channels, may_be_cut_below
from defocus_core.compare.metrics import equal_metrics, measure, measure_edges, measure_flip
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.picture import DecodedPicture, in_linear_light, read_picture
from defocus_core.compare.pixels import Pixels, count_nonfinite
from defocus_core.compare.record import (
    DIFFERENT,
    EXTRA,
    MISSING,
    SAME,
    UNREADABLE,
    WARNING,
    CompareSettings,
    Comparison,
    Worst,
)
from defocus_core.compare.selection import (
    CropRegion,
    coc_file,
    near_edges,
    read_mask,
    within_neighbours,
)
from defocus_core.compare.structure import (
    changed_metadata,
    compare_primaries,
    compare_samples,
    depths_of_samples,
    notes_of,
    of_another_size,
    of_structure,
)
from defocus_core.compare.thresholds import OVER, PRESETS, ROUNDING, Rule, Rules, rule
from defocus_core.errors import InputError, UsageProblem
from defocus_core.request.quantities import QuantityError
from defocus_core.system.text import counted

_NEVER_SILENT = (
    "clipped",
    "deep samples",
    "other primaries declared",
)  # findings that are a warning if no rule fails
_SMALL = 0.1  # scale of values below which rounding is a share of it
_SEEN = 0.5 / 255  # half a step of 8 bits, on the scale of hdr
_CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}


def compare_pair(
    pair: FilePair, rules: Rules, settings: CompareSettings
) -> tuple[Comparison, Pixels | None]:
    """Compare two files."""
    blank = Comparison(pair.name, pair.a, pair.b)
    if pair.a is None or pair.b is None:
        return replace(blank, status=MISSING if pair.b is None else EXTRA), None
    try:
        a = read_picture(pair.a)
        same = cmp(pair.a, pair.b, shallow=False)
        b = replace(a, path=pair.b) if same else read_picture(pair.b)
        return compare_pictures(pair.name, a, b, rules, settings)
    except InputError as error:
        return replace(blank, status=UNREADABLE, error=str(error)), None


def compare_pictures(
    name: str, a: DecodedPicture, b: DecodedPicture, rules: Rules, settings: CompareSettings
) -> tuple[Comparison, Pixels | None]:
    """Compare two pictures that have been read."""
    with np.errstate(all="ignore"):  # NaN and infinity are looked for, not stumbled upon
        return _compared(Comparison(name, a.path, b.path), a, b, rules, settings)


def _compared(
    blank: Comparison, a: DecodedPicture, b: DecodedPicture, rules: Rules, settings: CompareSettings
) -> tuple[Comparison, Pixels | None]:
    both = [name for name in a.planes if name in b.planes]
    resized = [name for name in both if a.planes[name].shape != b.planes[name].shape]
    common = [n for n in both if n not in resized and a.planes[n].shape == (a.height, a.width)]
    others = [name for name in both if name not in (*resized, *common)]  # as those of a thumbnail
    apart = [name for name in others if not _equal(a.planes[name], b.planes[name])]
    lone = depths_of_samples(a, b)
    findings = list(of_structure(a, b, resized, lone))
    if apart:
        text = f"other values in {', '.join(apart)}, which is of another size than the picture"
        findings.append(Finding("apart", text))
    ignored = settings.ignore_metadata
    metadata = changed_metadata(a, b, ignored)
    samples = compare_samples(a, b)
    strict = bool(findings) or (settings.metadata and bool(metadata))
    strict |= samples is not None and not rules.fail
    findings += [each for each in (compare_primaries(a, b, ignored), samples) if each is not None]
    record = replace(
        blank,
        size=(a.width, a.height),
        notes=tuple(notes_of(a, b, lone)),
        metadata=tuple(metadata),
        findings=tuple(findings),
    )
    if not common:
        findings += of_another_size(a, b)
        return replace(record, findings=tuple(findings), status=DIFFERENT), None
    if (a.gamma, a.associated) != (b.gamma, b.associated):
        a, b = in_linear_light(a), in_linear_light(b)
    pixels, corner = _pixels(a, b, common, settings)
    if rules.visible_only:
        pixels, unseen = pixels.visible()
        note = (f"other colours in {counted(unseen, 'pixel')} where A is 0",) if unseen else ()
        record = replace(record, notes=record.notes + note)
    rules = _of_small_values(rules, pixels)
    return _judged(record, pixels, corner, (a, b), rules, settings, strict=strict), pixels


def _of_small_values(rules: Rules, pixels: Pixels) -> Rules:
    """Rules whose bound for rounding follows the scale of A, where all its values are small."""
    if ROUNDING not in rules.fail:
        return rules
    finite = (np.abs(plane[np.isfinite(plane)]) for plane in pixels.a)
    scales = [np.percentile(values, 99.9) for values in finite if values.size]
    scale = max(map(float, scales), default=0.0)
    if not 0 < scale < _SMALL:
        return rules
    bound = ROUNDING.bound * scale
    small = replace(ROUNDING, bound=bound, text=f"{ROUNDING.metric}>{bound:.2g}")
    return replace(rules, fail=tuple(small if each == ROUNDING else each for each in rules.fail))


def _pixels(
    a: DecodedPicture, b: DecodedPicture, names: Sequence[str], settings: CompareSettings
) -> tuple[Pixels, tuple[int, int]]:
    """The pixels that are compared, and column and row of the first."""
    size = (a.height, a.width)
    cut = (slice(None), slice(None)) if settings.region is None else settings.region.cut(size)
    pixels = Pixels(
        names=tuple(names),
        a=tuple(a.planes[name][cut] for name in names),
        b=tuple(b.planes[name][cut] for name in names),
        gamma=a.gamma,
    )
    selected = _selected(size, settings)
    selected = None if selected is None else selected[cut]
    if settings.tolerate_edges:
        strict = ~within_neighbours(pixels.a, pixels.b)
        selected = strict if selected is None else strict & selected
    if selected is not None and not selected.any():
        chosen = settings.mask or settings.ignore_mask
        of = "picture" if settings.region is None else f"region {settings.region}"
        problem = f"leaves no pixel of the {of} to compare"
        remedy = "give masks and regions that leave some"
        raise InputError("empty", problem, remedy, path=chosen or a.path)
    pixels = replace(pixels, selected=selected)
    return pixels, (cut[1].start or 0, cut[0].start or 0)


def _selected(size: tuple[int, int], settings: CompareSettings) -> Any:
    """The pixels [H, W] that masks and regions leave; None for all."""
    if settings.mask is None and settings.ignore_mask is None and not settings.ignore_region:
        return None
    selected = np.ones(size, bool) if settings.mask is None else read_mask(settings.mask, size)
    for region in settings.ignore_region:
        selected[region.cut(size, "ignore_region")] = False
    if settings.ignore_mask is not None:
        selected &= ~read_mask(settings.ignore_mask, size, empty=True)
    return selected


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
    """The record with all that the pixels say, and the verdict."""
    nonfinite = count_nonfinite(pixels, corner)
    apart = nonfinite.apart is not None
    differing = pixels.differ
    metrics, near = _measured(record, pixels, corner, rules, settings, differing=differing)
    findings = [*record.findings, *nonfinite.findings()]
    if differing:
        findings += [*lost_channels(pixels), *clipped_light(pixels)]
        strict |= any(finding.name == "empty" for finding in findings)
    names = [finding.name for finding in findings]
    wants = any(_is_open(each, names, pixels) for each in (*rules.fail, *rules.warn))
    decided = any(each.is_met(metrics, ()) is not None for each in rules.fail if each.metric)
    decided |= any(each.found for each in rules.fail)
    bad = bool(_met(rules.fail, metrics, names)) if decided else differing
    suspect = bad or wants or (bool(_met(rules.warn, metrics, names)) and _is_seen(metrics))
    sought = differing and (wants or (settings.diagnose and suspect))
    if sought:
        named = {finding.name.split(" at ")[0] for finding in findings}
        coc = None if settings.coc is None else coc_file(settings.coc, record.name)
        causes = diagnose(pixels, *sides, corner, coc)
        findings += [cause for cause in causes if cause.name.split(" at ")[0] not in named]
    if suspect and differing:
        metrics = {**measure(pixels, over=rules.over), **metrics}
    names = [finding.name for finding in findings]
    failed, warned = (_met(each, metrics, names) for each in (rules.fail, rules.warn))
    warned += tuple(
        f"found:{n}" for n in names if n.startswith(_NEVER_SILENT) and not failed and not warned
    )
    record = replace(
        record,
        encoding={1.0: "linear", None: "sRGB"}.get(pixels.gamma, "power"),
        findings=tuple(findings),
        metrics=metrics,
        nonfinite=nonfinite,
        notes=(*record.notes, *nonfinite.notes()),
        edge_share=near,
        failed=failed,
        warned=warned,
        unmeasured=tuple(
            each.text for each in rules.fail if each.metric and each.metric not in metrics
        ),
    )
    if differing or apart:
        record = _placed(record, pixels, corner)
    if strict or apart or failed or (not decided and differing):
        given = any(each != ROUNDING for each in rules.fail)
        explained = not sought or any(not is_place(name) for name in names)
        open_ = not (strict or apart or given or explained)
        return replace(record, status=DIFFERENT, proposal=_proposal(metrics) if open_ else "")
    return replace(record, status=WARNING if warned else SAME)


def _measured(
    record: Comparison,
    pixels: Pixels,
    corner: tuple[int, int],
    rules: Rules,
    settings: CompareSettings,
    *,
    differing: bool,
) -> tuple[dict[str, float], float | None]:
    """The metrics that rules ask for, and the share of pixels near depth edges."""
    asked = rules.asked
    metrics = dict(
        measure(pixels, over=rules.over, asked=asked) if differing else equal_metrics(pixels)
    )
    if settings.flip:
        metrics |= measure_flip(pixels)
    if settings.coc is None:
        return metrics, None
    assert record.size is not None
    (width, height), (x, y), (high, wide) = record.size, corner, pixels.shape
    near = near_edges(settings.coc, record.name, (height, width))[y : y + high, x : x + wide]
    compared = near if pixels.selected is None else near[pixels.selected]
    return metrics | measure_edges(pixels, near), float(compared.mean())


def _met(
    rules: Sequence[Rule], metrics: Mapping[str, float], findings: Sequence[str]
) -> tuple[str, ...]:
    return tuple(each.text for each in rules if each.is_met(metrics, findings))


def _is_seen(metrics: Mapping[str, float]) -> bool:
    """Whether a pixel differs by as much as a screen of 8 bits can show, or it is not known."""
    return not metrics.get("hdr-max", math.inf) < _SEEN


def _is_open(rule: Rule, findings: Sequence[str], pixels: Pixels) -> bool:
    """Whether only a diagnosis says if a finding is there that a rule is about."""
    if not rule.found or rule.is_met({}, findings):
        return False
    # Light that is cut off above is always found.
    return rule.found != "clipped" or may_be_cut_below(pixels)


def _placed(record: Comparison, pixels: Pixels, corner: tuple[int, int]) -> Comparison:
    """The record with the worst pixel, and where pixels differ."""
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


def _proposal(metrics: Mapping[str, float]) -> str:
    """The tightest rule of two digits that lets a pair pass; none if a black B passed, too."""
    greatest, relative = metrics.get("max"), metrics.get("rel-rmse")
    if not greatest or not relative or not math.isfinite(greatest):
        return ""
    digit = 10.0 ** (math.floor(math.log10(greatest)) - 1)
    bound = math.ceil(greatest / digit) * digit
    level = metrics["rmse"] / relative  # the mean of A
    return f"max>{bound:.3g}" if bound < level else ""


def _equal(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f" and b.dtype.kind == "f"))


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
    """Say whether a picture is the same as another one, and if not, what happened to it.

    Without rules to fail all values must be equal. Another size or channel, and NaN or infinity on
    one side only, are never the same.

    Args:
        a: The reference: a file of colour or of a map; an array [H, W] or [H, W, C], linear; or a
            tensor [H, W], [C, H, W] or [1, C, H, W].
        b: What is judged, likewise.
        fail: Rules like ``psnr<45``: b fails if it meets one.
        warn: Rules that only give a warning.
        over: The difference that the metric ``share`` counts pixels beyond.
        region: x, y, width and height in px of what is compared.
        mask: A file that is not 0 where pixels are compared.
        flip: Whether FLIP is measured.
        metadata: Whether metadata of files that differs fails, too.
        diagnose: Whether the cause of a difference is looked for.
        like: A set of rules where none are given: ``render`` (the same program on another machine),
            ``encoder`` (a lossy codec) or ``golden`` (the same program and machine).

    Returns:
        Its ``status`` (same, warning or different), ``passes``, ``metrics`` by name (max, psnr,
        …), ``findings`` (what happened to b, each with its ``name``, ``text`` and ``values``), the
        ``worst`` pixel, the ``window`` of all that differ, and more.

    Raises:
        InputError: A file cannot be read, or the mask is of another size.
        UsageProblem: A rule makes no sense, or the region is not within the picture.
        ValueError: An array is no picture.
    """
    if like is not None and like not in PRESETS:
        raise UsageProblem(
            "unknown-name", f"'{like}' is not known", f"name {', '.join(PRESETS)}", field="like"
        )
    known = Rules() if like is None else PRESETS[like]
    fail_by, warn_by = _rules("fail", fail) or known.fail, _rules("warn", warn) or known.warn
    rules = replace(known, fail=fail_by, warn=warn_by, over=over)
    settings = CompareSettings(
        region=None if region is None else CropRegion(*region),
        mask=None if mask is None else Path(mask),
        flip=flip,
        metadata=metadata,
        diagnose=diagnose,
    )
    one, other = _picture(a, "a"), _picture(b, "b")
    return compare_pictures(other.path.name, one, other, rules, settings)[0]


def of_planes(planes: dict[str, Any], name: str) -> DecodedPicture:
    """Channels [H, W] of linear light as a picture of that name."""
    height, width = next(iter(planes.values())).shape
    types = {channel: plane.dtype.name for channel, plane in planes.items()}
    return DecodedPicture(Path(name), width, height, planes, types)


def planes_of(image: Any) -> dict[str, Any]:
    """Channels [H, W], half or float, of an array or a tensor."""
    if hasattr(image, "detach"):  # a tensor, whose channels come first
        values = np.asarray(image.detach().cpu().numpy())
        values = values[0] if values.ndim == 4 and values.shape[0] == 1 else values
        values = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
    else:
        values = np.asarray(image)
    if values.dtype.kind not in "fiub":
        raise ValueError(f"image must have real numbers, got {values.dtype}")
    if values.dtype != np.float16:
        wide = values
        with np.errstate(over="ignore"):
            values = values.astype(np.float32)
        if np.any(np.isinf(values) & np.isfinite(wide)):
            raise ValueError(f"image must have values of 32 bits, got {np.nanmax(np.abs(wide)):g}")
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in _CHANNELS or not values.size:
        wanted = "[H, W], [H, W, C] or, as a tensor, [C, H, W] with 1 to 4 channels"
        raise ValueError(f"image must be {wanted}, got {list(np.shape(image))}")
    names = _CHANNELS[values.shape[2]]
    return {name: np.ascontiguousarray(values[..., k]) for k, name in enumerate(names)}


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
