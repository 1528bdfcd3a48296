"""Removed options, values, keys of files, commands and Python names, and their replacements.

To remove a name, add a row under the version that removes it; nothing else is needed, as every
error of an unknown name looks here first. Such an error then ends in ``it was removed in 0.2.0:
INSTEAD``, where INSTEAD is an imperative without a full stop, which names options in angle quotes.
The kinds of rows:

- ``option``: of the command line, without dashes; ``of`` is the command that lost it, if others
  keep it. Without ``of`` it is a key of any file, too: of jobs, lenses, rows, keys of frames.
- ``key``: of files only, or with another replacement than its option; ``of`` is its table.
- ``value``: of the option or key ``of``, and of the argument of that name in Python.
- ``rule``: a metric in the rules of compare, or ``found:`` and a finding.
- ``command``: of ``defocus``.
- ``python``: a name of `defocus_core`; or, if ``of`` is a class, an option, attribute or argument.

A row stays for two versions, which ``tests/core/test_gone.py`` checks.
"""

from __future__ import annotations

from typing import NamedTuple


class Gone(NamedTuple):
    """A removed name, and what to write instead of it."""

    kind: str  # option, key, value, rule, command or python
    name: str
    instead: str  # an imperative without a full stop
    of: str = ""  # the command, table, option or class that lost it; empty for all


_CALIBRATED = "give ‹depth-kind› disparity, ‹focal-px›, ‹baseline› and, if it has one, ‹doffs›"
_APART = "compare twice, with ‹mask› and with ‹ignore-mask›"
# Removed findings of compare, by their replacements.
_FINDINGS = {
    "softer": ("noise removed", "motion blur", "softened", "spread otherwise"),
    "sharper": ("sharpened",),
    "another CoC": ("another bokeh shape",),
    "offset or contrast": ("raised blacks", "lowered blacks", "another contrast", "offset"),
    "primaries or saturation": ("another saturation", "monochrome", "other primaries"),
    "inverted": ("sign reversed",),
    "scaled": ("chromatic aberration", "sheared"),
    "fireflies or few pixels": ("fireflies", "dropped pixels"),
    "in one region": ("overlay",),
    "*": (
        *("vignette", "missing layer", "fields exchanged", "tiles exchanged", "doubled", "eroded"),
        *("dilated", "damaged lines", "halo", "bloom", "apart", "in shadows"),
        *("in focus only", "out of focus only"),
    ),
}
# Names that are no longer exported, by the module that has them.
_UNEXPORTED = {
    "allowed_values": "AUTO_LIGHTS QUALITIES",
    "batch.datasets.finished": "Sample",
    "batch.workers.run": "Summary",
    "compare.findings.table": "Finding",
    "compare.record": "Comparison",
    "depth.diagnosis": "DepthRepair",
    "evaluation": "baselines metrics",
    "evaluation.lens_laws": "Check LawSetting LAWS verify",
    "evaluation.metrics": "Errors",
    "fitting.pair": "Fit",
    "io.depth_formats.depth": "Depth",
    "io.images.color": "Color",
    "optics.axial_color": "color_offset",
    "optics.parts": "Sensitivity",
    "optics.thin_lens": "fnum_of_strength",
    "renderer.random_defocus": "Lenses",
    "request.job": "Job",
}
GONE: dict[str, tuple[Gone, ...]] = {
    "0.2.0": (
        Gone("command", "report", "give the batch's command again with ‹contact› 12"),
        Gone("option", "resize-depth", "look at the pair by 'defocus render' ‹dry-run›", "info"),
        Gone("option", "name", "give each lens an -o of its own, or sweep it by 'batch'", "render"),
        Gone("option", "turn-depth", "turn the depth file as Exif turns the colour"),
        Gone("option", "animate", "look at a frame by 'defocus render' ‹dry-run›", "info"),
        Gone("option", "html", "write ‹contact› 12 for a sheet of pictures", "batch"),
        Gone("command", "retry", "give the batch's own command again, it does failed jobs"),
        Gone("key", "match", "draw the lenses in ranges, like those of the set", "[sample]"),
        Gone("option", "launches", "run test_launches.py of the repository", "bench"),
        Gone("option", "radii", "give scenes of such blur, ‹truth›", "bench"),
        Gone("option", "sizes", "give scenes of such a size, ‹truth›", "bench"),
        Gone("option", "time", "read the seconds beside the errors", "bench"),
        Gone("option", "accept", "find another lens of the pair, by ‹shift› or ‹dp-model›", "fit"),
        Gone("option", "blades", "leave it out, the pupil is round", "fit"),
        Gone("option", "dp-crosstalk", "find it, ‹dual-pixel›", "fit"),
        Gone("option", "fnumber", "leave it out, it is found", "fit"),
        Gone("option", "focus", "leave it out, it is found", "fit"),
        Gone("option", "gamma", "give linear light, or ‹color-space›", "fit"),
        Gone("option", "side-shading", "add ‹exposure›, which finds a falloff of each", "fit"),
        Gone("option", "match", "draw the lenses of a set in [sample] of a jobs file", "fit"),
        Gone("option", "motion", "leave it out, or give what is hidden by ‹hidden› COLOR DEPTH"),
        Gone("python", "Frame", "give what is hidden to render() as a HiddenLayer"),
        Gone("python", "chained", "give what is hidden to render() as a HiddenLayer"),
        Gone("python", "seen_behind", "give what is hidden to render() as a HiddenLayer"),
        Gone("python", "temporal_mean", "average radii where you know that the scene is still"),
        Gone("command", "golden", "render by batch to NEW, then compare goldens NEW ‹accept›"),
        *(
            Gone("rule", f"found:{name}", f"write found:{now}")
            for now, names in _FINDINGS.items()
            for name in names
        ),
        Gone("option", "coc", _APART, "compare"),
        *(
            Gone("python", name, "cut the array, or call compare_images()", "golden.check")
            for name in ("region", "ignore_region", "mask", "ignore_mask", "tolerate_edges")
        ),
        Gone("python", "fail", "write bounds, like psnr=45", "golden.check"),
        Gone("python", "thresholds", "write bounds, like psnr=45", "golden.check"),
        *(
            Gone("rule", f"{place}-{metric}", _APART)
            for place in ("edges", "elsewhere")
            for metric in ("max", "mean", "rmse", "psnr")
        ),
        Gone("key", "max-coc", "limit radii by clamp-blur, or draw the focus in percentiles"),
        Gone("key", "depth-repair", "write it below [reading]", "[machine]"),
        Gone("value", "draft", "write standard", "quality"),
        Gone("python", "signed_coc", "write 2 * pixel_size * signed_radius(depth)", "DefocusLens"),
        Gone("option", "aperture-diameter", "write fnumber, the focal length by the diameter"),
        Gone("option", "focus-smooth", "give smoothed keys of focus by ‹animate›"),
        Gone("option", "interpolate", "give more keys, between two of them the blur is even"),
        Gone("key", "interpolation", "give more keys, between them the blur is even", "[animate]"),
        Gone("option", "unpremultiply-depth", "leave it out, depth is divided where edges show it"),
        *(
            Gone("value", name, _CALIBRATED, "depth-format")
            for name in ("spring", "unrealstereo4k", "hci-lightfield", "middlebury2006")
        ),
        Gone("value", "eth3d", "save its rows as NPY, and write metres", "depth-format"),
        Gone("value", "ffs-stereo4d", "save its px as NPY, and write disparity", "depth-format"),
        Gone("value", "infinigen", "save its first plane as NPY, and write metres", "depth-format"),
        Gone("value", "irs", "write disparity, with ‹depth-channel› G", "depth-format"),
        Gone("value", "moge-png", "write moge, for the EXR of MoGe", "depth-format"),
        Gone("value", "omniobject3d", "write metres, with ‹depth-channel›", "depth-format"),
        Gone("value", "ros", "write png-mm for 16 bits, metres for floats", "depth-format"),
        Gone("value", "urbansyn", "write metres, with ‹depth-scale› 1e5 and ‹sky›", "depth-format"),
        Gone("value", "synscapes", "write metres, with ‹sky›", "depth-format"),
        Gone("python", "diagnose_depth", "write repair_depth(radius, image)[1]"),
        *(
            Gone("python", name, f"import it from defocus_core.{module}")
            for module, names in _UNEXPORTED.items()
            for name in names.split()
        ),
        Gone("python", "rim_size", "write cat_eye_size", "RandomDefocus"),
        Gone("python", "rim_shift", "write cat_eye_shift", "RandomDefocus"),
    )
}


def remedy(kind: str, name: object, of: str = "", otherwise: str = "") -> str:
    """What to write instead of an unknown name; ``otherwise`` if the name was not removed.

    `kind`, `of`: as in `Gone`.
    """
    for version, rows in GONE.items():
        for row in rows:
            if (row.kind, row.name) == (kind, name) and row.of in ("", of):
                return f"it was removed in {version}: {row.instead}"
    return otherwise


def remedy_of_key(name: str, table: str, otherwise: str) -> str:
    """`remedy` for a key in a table of a file, which may have the name of an option."""
    name = name.replace("_", "-")
    return remedy("key", name, table, remedy("option", name, otherwise=otherwise))
