"""Reads what an HTML report holds."""

import json
import re
import shlex

from command_line import run

_DATA = re.compile(r'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)


def items(file):
    """The items of a report, in their order."""
    (data,) = _DATA.findall(file.read_text())
    return list(json.loads(data)["items"])


def item(file, name):
    return next(each for each in items(file) if each["name"] == name)


def command(file, name, title):
    """The words of a command line of an item."""
    return shlex.split(dict(item(file, name)["commands"])[title])


def run_command(file, name, title, *more):
    """Run a command line of ours that a report shows."""
    program, *words = command(file, name, title)
    assert program == "defocus"
    return run(*words, *more)


def keys(each, *, valued=False):
    """The keys of the layers of an item, or of those with values."""
    return [layer["key"] for layer in each["layers"] if layer["values"] or not valued]
