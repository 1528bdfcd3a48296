"""What happened to B: explanations tried in turn, and the one that leaves least is the finding."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from defocus_core.compare.findings import geometry, sharpness, tone
from defocus_core.compare.findings.evidence import Evidence, Explanation, best
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import DecodedPicture, in_linear_light, read_picture
from defocus_core.compare.pixels import Pixels
from defocus_core.errors import InputError

_COC_ATTRIBUTE = "defocus:coc_px"  # of a render: the range of its signed radii
_MAPS_OF_COC = {"coc", "disparity"}


def diagnose(pixels: Pixels, types: Mapping[str, str], file_a: Path | None) -> list[Finding]:
    """The cause of the differences of a pair that has some, or none where evidence is lacking.

    Args:
        pixels: the pair.
        types: number types of the channels of B.
        file_a: the file of A, beside which the other of the left and right view may be.
    """
    evidence = Evidence(pixels, types)
    chosen = best([*tone.explanations(evidence)])
    if chosen is None or chosen.left > 0:
        explanations = geometry.explanations(evidence, _other_view(pixels, file_a))
        chosen = best([*filter(None, [chosen]), *explanations])
    if set(evidence.names) <= _MAPS_OF_COC and _is_of_values(chosen):
        return _of_maps(evidence)
    if chosen is None:
        return list(sharpness.findings(evidence)) if pixels.color else []
    finding = chosen.finding
    return [
        Finding(finding.name, finding.text, finding.values, round(max(0.0, 1 - chosen.left), 4))
    ]


def _is_of_values(chosen: Explanation | None) -> bool:
    """Whether a map differs in its values and not in their places: no cause, or a tone."""
    return chosen is None or chosen.finding.name in ("another exposure", "another gamma")


def _of_maps(evidence: Evidence) -> list[Finding]:
    """Maps of the circle of confusion that differ, with their ranges."""
    findings = []
    for name, a, b in zip(evidence.names, evidence.a, evidence.b, strict=True):
        old, new = ([float(side.min()), float(side.max())] for side in (a, b))
        ranges = (f"{least:.2f} to {most:.2f} px" for least, most in (new, old))
        text = f"another CoC: {name} {' instead of '.join(ranges)}"
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


def declared_coc(a: DecodedPicture, b: DecodedPicture) -> list[Finding]:
    """Another CoC by the headers of two renders of defocus, where the pixels do not show it."""
    texts = (side.metadata.get(_COC_ATTRIBUTE, "") for side in (a, b))
    try:
        old, new = ([float(number) for number in text.split()] for text in texts)
    except ValueError:  # another program's attribute
        return []
    if old == new or len(old) != 2 or len(new) != 2:
        return []
    ranges = (f"{least:.2f} to {most:.2f} px" for least, most in (new, old))
    text = f"another CoC: {' instead of '.join(ranges)}, as the headers say"
    return [Finding("another CoC", text, {"a": old, "b": new})]


def _other_view(pixels: Pixels, file_a: Path | None) -> dict[str, Any] | None:
    """Channels of the file that is the other of the left and right view of A, if there is one."""
    partner = None if file_a is None else geometry.view_partner(file_a)
    if partner is None:
        return None
    try:
        picture = read_picture(partner)
    except InputError:  # it is judged as a pair of its own
        return None
    linear = pixels.gamma == 1.0
    return dict((in_linear_light(picture) if linear else picture).planes)
