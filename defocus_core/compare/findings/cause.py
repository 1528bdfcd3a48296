"""What happened to B: explanations tried in turn, and the one that leaves least is the finding."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from defocus_core.compare.findings import filters, geometry, tone, traces
from defocus_core.compare.findings.evidence import Evidence, Explanation, best
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import in_linear_light, read_picture
from defocus_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from defocus_core.compare.picture import DecodedPicture
    from defocus_core.compare.pixels import Pixels

_MAPS_OF_COC = {"coc", "disparity"}
# Attributes of a render by what follows if they differ.
_OF_A_LENS = {
    "another CoC": ("fnumber", "focus", "focal_length", "coc_px"),
    "another bokeh shape": ("blades", "blade_rotation"),
}
_SPREADS = ("another CoC", "another CoC or bokeh shape", "spread otherwise")
_LAST_BITS = 2e-5  # largest difference that is that of another machine, on no scale to be seen
_CERTAIN = 0.03  # left of a difference, below which nothing else is tried


def diagnose(pixels: Pixels, a: DecodedPicture, b: DecodedPicture) -> list[Finding]:
    """The cause of the differences of a pair that has some, or none where evidence is lacking.

    Args:
        pixels: the pair.
        a: the picture A, beside whose file the other view and other frames may be.
        b: the picture B.
    """
    evidence = Evidence(pixels, b.types)
    old, new = (evidence.scaled(side) for side in evidence.sampled)
    if old.size and float(abs(new - old).max()) < _LAST_BITS:
        return []
    tried = list(tone.explanations(evidence))
    kinds: list[Iterator[Explanation]] = [
        geometry.explanations(evidence, _others(pixels, a.path)),
        traces.explanations(evidence),
    ]
    if pixels.color:
        kinds.append(filters.explanations(evidence))  # the dearest
    for kind in kinds:
        chosen = best(tried)
        if chosen is None or chosen.left + chosen.cost > _CERTAIN:
            tried += kind
    chosen = best(tried)
    if set(evidence.names) <= _MAPS_OF_COC and _is_of_values(chosen):
        return _of_maps(evidence)
    if chosen is None:
        return []
    finding = _by_metadata(chosen.finding, a.metadata, b.metadata)
    share = round(max(0.0, 1 - chosen.left), 4)
    return [Finding(finding.name, finding.text, finding.values, share)]


def _by_metadata(finding: Finding, a: Mapping[str, str], b: Mapping[str, str]) -> Finding:
    """Light that is spread otherwise, by the lens that the metadata of two renders name."""
    if finding.name not in _SPREADS:
        return finding
    for name, attributes in _OF_A_LENS.items():
        changes = [
            f"{key} {b[full]} instead of {a[full]}"
            for key in attributes
            for full in [f"defocus:{key}"]
            if full in a and full in b and a[full] != b[full]
        ]
        if changes:
            how = finding.text.partition(": ")[2]
            said = f"{name}: {how} ({', '.join(changes)}, by the metadata)"
            return Finding(name, said, finding.values)
    return finding


def _is_of_values(chosen: Explanation | None) -> bool:
    """Whether a map differs in its values and not in their places: no cause, or a tone."""
    tones = ("another exposure", "another gamma", "raised blacks", "lowered blacks", "noise")
    return chosen is None or chosen.finding.name in tones


def _of_maps(evidence: Evidence) -> list[Finding]:
    """Maps of the circle of confusion that differ, with their ranges."""
    findings = []
    for name in evidence.names:
        planes = (evidence.at(side, slice(None), slice(None), [name]) for side in ("a", "b"))
        old, new = ([float(plane.min()), float(plane.max())] for plane in planes)
        ranges = [f"{minimum:.2f} to {maximum:.2f} px" for minimum, maximum in (new, old)]
        text = f"another CoC: {name} {' instead of '.join(dict.fromkeys(ranges))}"
        findings.append(Finding("another CoC", text, {"a": old, "b": new}))
    return findings


def of_another_size(a: DecodedPicture, b: DecodedPicture) -> Iterator[Finding]:
    """How a picture of another size comes from A, if that is seen."""
    sizes = [(side.height, side.width) for side in (a, b)]
    planes = [
        {name: plane for name, plane in side.planes.items() if plane.shape == size}
        for side, size in zip((a, b), sizes, strict=True)
    ]
    yield from geometry.resized(*planes)


def _others(pixels: Pixels, file_a: Path | None) -> dict[str, dict[str, Any]]:
    """Channels of files beside that of A, by the finding that B is one of these."""
    others = {}
    for name, path in geometry.partners(file_a):
        try:
            picture = read_picture(path)
        except InputError:  # it is judged as a pair of its own
            continue
        linear = pixels.gamma == 1.0
        others[name] = dict((in_linear_light(picture) if linear else picture).planes)
    return others
