"""The choice of a cause: models are tried in turn, and that with the smallest residual wins.

A cause is named if its residual is at most half of the difference, and half of the residual of each
rival. A model that includes a simpler one is not a rival of it, and replaces it only if it halves
the residual. If two rivals have similar residuals, no cause is named, and the text on the place of
the difference mentions both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.compare.findings.evidence import Evidence, Explanation
from defocus_core.compare.findings.places import coc_map, place_of
from defocus_core.compare.findings.table import BEYOND, CAUSES, LEFT, Finding, fixed_words
from defocus_core.compare.pairing import partners
from defocus_core.compare.picture import DecodedPicture, in_linear_light, read_picture
from defocus_core.compare.pixels import Pixels
from defocus_core.errors import InputError

# Attributes of a render that decide its CoC.
_OF_A_COC = ("fnumber", "focus", "focal_length", "coc_px", "blades", "blade_rotation")
_LAST_BITS = 2e-5  # largest difference, invisible on any scale, that another machine may cause
_HALF = 0.5**0.5  # greatest residual by that of a rival: half in squares
_SIMPLER = 0.5  # the same by that of a simpler case
_LEFT_OF_FEW = 0.06  # the same for a picture of few pixels
_WEAK = 0.35  # residual above which a fit yields to one by looks, and to a patch
_BESIDE_NOISE = 0.15  # the same beside noise, as far as it can be measured
_ALL = 2e-3  # residual of a complete explanation: the first such cause is named
_NEARLY_ALL = 0.15  # residual of a model, at which those of further modules are not tried


def diagnose(
    pixels: Pixels, a: DecodedPicture, b: DecodedPicture, corner: tuple[int, int] = (0, 0)
) -> list[Finding]:
    """The finding of the cause of the differences, or of their place; empty if both are unknown."""
    codecs = a.layout.get("compression", ""), b.layout.get("compression", "")
    evidence = Evidence(pixels, b.types, _others(a.path, as_light=pixels.gamma == 1.0), codecs)
    old, new = (evidence.scaled(side) for side in evidence.sampled)
    if old.size and float(abs(new - old).max()) < _LAST_BITS:
        return []
    chosen, tied = _decided(evidence)
    if chosen is not None:
        finding = _by_channels(_by_lens(chosen.finding, a, b), evidence)
        return [replace(finding, explained=round(evidence.explained(chosen.left), 4))]
    if evidence.is_slight:
        return [Finding("too small to name", "too small to name")]
    place = place_of(evidence, (a, b), corner)
    if place is None or not tied:
        return [] if place is None else [place]
    both = " or ".join(f"{each.name} ({1 - each.left:.0%})" for each in tied)
    return [replace(place, text=f"{place.text}; as well by {both}")]


def _decided(evidence: Evidence) -> tuple[Explanation | None, Sequence[Explanation]]:
    """The explanation to name, or None; then the two best ones if they tie."""
    fits = [*_fits(evidence, looks=False)]
    chosen, good = _chosen(fits, evidence)
    if chosen is not None and chosen.left <= _WEAK:
        return chosen, ()
    # What neighbours have in common may have a cause, and the rest may be noise.
    but_noise = [
        replace(fit, left=max(fit.but_noise, _BESIDE_NOISE), but_noise=fit.left) for fit in fits
    ]
    if chosen is None and evidence.is_slight:
        return None, ()
    common = None if chosen is not None else _chosen(but_noise, evidence)[0]
    if common is not None:
        return replace(common, left=common.but_noise, how=f"{common.how}, and noise"), ()
    # Causes known by their looks have other measures.
    known = good if chosen is None else [chosen]
    most = min((_SIMPLER * fit.left for fit in known), default=1.0)
    for fit in _fits(evidence, looks=True):
        if _is_enough(fit, evidence) and fit.left <= most:
            return fit, ()
    if chosen is not None:
        return None if evidence.is_patch else chosen, ()
    return None, good[:2] if len(good) > 1 else ()


def _chosen(
    fits: Sequence[Explanation], evidence: Evidence
) -> tuple[Explanation | None, Sequence[Explanation]]:
    """The fit to name, and an empty sequence; or None, and all good fits, the best first.

    The fit to name beats its rivals, and is not beaten by a fit of a more general model.
    """
    best: dict[str, Explanation] = {}
    for fit in fits:
        known = best.get(fixed_words(fit.name))
        if known is None or fit.left <= _HALF * known.left > _HALF * _ALL:
            best[fixed_words(fit.name)] = fit
    good = [best[name] for name in LEFT if name in best and _is_enough(best[name], evidence)]
    for fit in good:  # the simpler ones first
        others = [each for each in best.values() if each is not fit]
        general = [each for each in good if each is not fit and _is_beyond(each, fit)]
        rivals = [e for e in others if not (_is_beyond(e, fit) or _is_beyond(fit, e))]
        if not any(e.left <= _SIMPLER * fit.left > _SIMPLER * _ALL for e in general) and all(
            fit.left <= max(_HALF * each.left, _ALL) for each in rivals
        ):
            return fit, ()
    return None, sorted(good, key=lambda fit: fit.left)


def _fits(evidence: Evidence, *, looks: bool) -> Iterator[Explanation]:
    """The fits of causes: of those known by the looks of the difference, or of the others.

    No further module is tried after a fit that explains nearly all of the difference.
    """
    models, least = dict.fromkeys(row.model for row in CAUSES if row.looks == looks), math.inf
    for module, some in groupby(models, lambda model: model.partition(".")[0]):
        if least <= _NEARLY_ALL:
            return
        for model in some:
            found = getattr(import_module(f"{__package__}.{module}"), model.partition(".")[2])
            for fit in found(evidence):
                least = min(least, fit.left)
                yield fit


def _is_enough(fit: Explanation, evidence: Evidence) -> bool:
    """Whether a cause explains enough of the difference."""
    few = not evidence.is_small or fit.left <= _LEFT_OF_FEW
    return few and evidence.explained(fit.left) >= 1 - LEFT[fixed_words(fit.name)]


def _is_beyond(fit: Explanation, other: Explanation) -> bool:
    """Whether the model of `fit` includes that of `other`, or both have the same name."""
    kind = fixed_words(fit.name)
    return fixed_words(other.name) in (*BEYOND[kind], kind)


def _by_channels(finding: Finding, evidence: Evidence) -> Finding:
    """The finding; its text begins with the channels that differ, if these are only some."""
    names, colors = {*evidence.names}, {n for layer in evidence.pixels.color for n in layer}
    every = names == {*evidence.pixels.names} or (colors and colors <= names)
    if every or names <= {*finding.values} or "factors" in finding.values:
        return finding
    return replace(finding, text=f"{', '.join(evidence.names)}: {finding.text}")


def _by_lens(finding: Finding, a: DecodedPicture, b: DecodedPicture) -> Finding:
    """The finding, renamed to another CoC if metadata or CoC maps of both files differ."""
    if finding.name not in ("softer", "sharper"):
        return finding
    keys = ((key, f"defocus:{key}") for key in _OF_A_COC)
    both = [(key, a.metadata.get(name), b.metadata.get(name)) for key, name in keys]
    changes = [
        f"{k} {now} instead of {was}" for k, was, now in both if was and now not in (was, None)
    ]
    if not changes:
        was, now = coc_map(a), coc_map(b)
        changes = ["by the CoC maps"] * (
            not (was is None or now is None or np.array_equal(was, now))
        )
    how = f"another CoC: {finding.text} ({', '.join(changes)})"
    return replace(finding, name="another CoC", text=how) if changes else finding


def _others(path: Path, *, as_light: bool) -> dict[str, Mapping[str, Any]]:
    """Channels of files beside A of which B may be a copy, by the name of the finding."""
    others: dict[str, Mapping[str, Any]] = {}
    for name, file in partners(path):
        with suppress(InputError):  # it is compared as a pair of its own
            picture = read_picture(file)
            others[name] = (in_linear_light(picture) if as_light else picture).planes
    return others
