"""Names of pictures by a template like ``{stem}_{focus}``, and the pictures of several views."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.lenses.parameters import LENS_OPTIONS
from defocus_core.batch.lenses.quantities import Percentile
from defocus_core.errors import UsageProblem, did_you_mean

STEM = "{stem}"
_FIELD = re.compile(r"\{([^{}]*)\}")
_FOCUS = ("focus-at", "focus-value")  # what is instead of a distance
_OPTIONS = ("focus", "fnumber", "focal-length", "blur")
FIELDS = ("stem", "view", *_OPTIONS)


def of_views(jobs: Sequence[Job], template: str | None) -> list[Job]:
    """The jobs of each view that ``view`` names, like left,right, named by a template.

    `template`: of the names, None for the stem, and the view where there are several.
    """
    views = [job.reading.view or "" for job in jobs]
    if template is None:
        template = "{stem}_{view}" if any("," in names for names in views) else STEM
    if template == STEM:
        return list(jobs)
    apart = [
        replace(job, reading=replace(job.reading, view=view.strip() or None))
        for job, names in zip(jobs, views, strict=True)
        for view in dict.fromkeys(names.split(","))
    ]
    return [replace(job, picture=replace(job.picture, stem=_name(job, template))) for job in apart]


def _name(job: Job, template: str) -> str:
    def value(field: re.Match[str]) -> str:
        name = field[1]
        if name not in FIELDS:
            remedy = did_you_mean(name, FIELDS, f"write {' or '.join(f'{{{n}}}' for n in FIELDS)}")
            raise UsageProblem("unknown-name", f"{field[0]} is no field", remedy, field="name")
        if name == "stem":
            return job.picture.stem
        if name == "view":
            return job.reading.view or "view"
        return _tag(job, name)

    made = _FIELD.sub(value, template)
    if not made or "/" in made or made.startswith(".") or not made.isprintable():
        problem = f"'{made}' cannot name a file"
        raise UsageProblem("malformed", problem, "write it like '{stem}_{focus}'", field="name")
    return made


def _tag(job: Job, name: str) -> str:
    """What sweeps call a value of the lens in names, like ``f1.4``."""
    lens = job.lens
    if name == "focus" and lens.focus_percentile is not None:
        return LENS_OPTIONS[name].file_tag(Percentile(lens.focus_percentile))
    if name == "focus":
        name = next((n for n in _FOCUS if getattr(lens, LENS_OPTIONS[n].field) is not None), name)
    row = LENS_OPTIONS[name]
    return row.file_tag(getattr(lens, row.field))
