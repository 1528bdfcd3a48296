"""Reads what an HTML report holds."""

import json
import re

_DATA = re.compile(r'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)


def items(file):
    """The items of a report, in their order."""
    (data,) = _DATA.findall(file.read_text())
    return list(json.loads(data)["items"])


def item(file, name):
    return next(each for each in items(file) if each["name"] == name)


def keys(each, *, valued=False):
    """The keys of the layers of an item, or of those with values."""
    return [layer["key"] for layer in each["layers"] if layer["values"] or not valued]
