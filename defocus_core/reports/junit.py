"""JUnit XML, which CI servers show: a test case for each pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from defocus_core.compare.record import UNREADABLE, WARNING, Comparison
from defocus_core.errors import printable
from defocus_core.io.safe_files import written_whole
from defocus_core.reports.comparison_words import line
from defocus_core.reports.replaceable import refuse_other


def write_junit(path: Path, records: Sequence[Comparison], seconds: float) -> None:
    """Write a suite with a failure for each pair that differs, an error for each unreadable one."""
    counts = Counter(record.status for record in records)
    failures = sum(not record.passes for record in records) - counts[UNREADABLE]
    numbers = {"tests": len(records), "failures": failures, "errors": counts[UNREADABLE]}
    totals = {**{key: str(value) for key, value in numbers.items()}, "time": f"{seconds:.3f}"}
    root = ElementTree.Element("testsuites", totals)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "defocus compare", **totals})
    for record in records:
        name = Path(record.name)
        group = ".".join(("compare", *name.parts[:-1]))
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": printable(group), "name": printable(name.name)}
        )
        text = printable(line(record))
        if not record.passes:
            kind = "error" if record.status == UNREADABLE else "failure"
            attributes = {"type": record.status, "message": text}
            ElementTree.SubElement(case, kind, attributes).text = text
        elif record.status == WARNING:
            ElementTree.SubElement(case, "system-out").text = text
    ElementTree.indent(root)
    refuse_other(path, "junit")
    with written_whole(path) as file:
        ElementTree.ElementTree(root).write(file, "utf-8", xml_declaration=True)
