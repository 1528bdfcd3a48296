"""What went is refused wherever it is written, with the words that replace it: row by row."""

import re
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version

import numpy as np
import pytest
from command_line import run

import defocus_core as df
from defocus_cli.main import COMMANDS
from defocus_core.gone import GONE

ROWS = [(row, since) for since, rows in GONE.items() for row in rows]
KINDS = ("option", "key", "value", "rule", "command", "python")


def rows(kind):
    """The rows of a kind, each with the end of its error."""
    for row, since in ROWS:
        if row.kind == kind:
            yield row, f"it was removed in {since}: {row.instead}"


def fails(words, *args):
    """Assert that the command line refuses what went."""
    ran = run(*args)
    assert ran.code == 2
    assert re.sub("‹(.*?)›", r"--\1", words) in ran.err


@contextmanager
def told(words):
    with pytest.raises(df.UsageProblem) as error:
        yield
    assert error.value.remedy == words


def test_rows_stay_for_two_versions():
    major, minor, *_ = map(int, version("defocus").split("."))
    assert {*GONE} <= {f"{major}.{minor}.0", f"{major}.{minor - 1}.0"}


def test_each_row_has_a_kind_and_stands_once():
    names = [(row.kind, row.name, row.of) for row, _ in ROWS]
    assert {kind for kind, _, _ in names} <= {*KINDS}
    assert len(names) == len(set(names))


def test_commands_and_options_that_went():
    for row, words in rows("command"):
        fails(words, row.name, "out")
    for row, words in rows("option"):
        for command in (row.of,) if row.of else COMMANDS:
            fails(words, command, f"--{row.name}")


def test_keys_that_went(tmp_path):
    of_options = ((row, words) for row, words in rows("option") if not row.of)
    for row, words in [*rows("key"), *of_options]:
        table = (row.of or "[lens]").strip("[]")
        tables = {"inputs": {"color": "a.exr"}, table: {row.name: 1}}
        with told(words):
            df.batch_jobs(tables, tmp_path)


def test_values_that_went(tmp_path):
    for row, words in rows("value"):
        fails(words, "render", "a.exr", "-o", tmp_path, f"--{row.of}", row.name)
        table = "machine" if row.of == "quality" else "reading"
        tables = {"inputs": {"color": "a.exr"}, table: {row.of: row.name}}
        with told(words):
            df.batch_jobs(tables, tmp_path)
        if row.of == "depth-format":
            with told(words):
                df.read_depth(tmp_path, format=row.name)


def test_rules_of_compare_that_went():
    for row, words in rows("rule"):
        rule, picture = (row.name if ":" in row.name else f"{row.name}<1"), np.zeros((2, 2))
        with told(words):
            df.compare_images(picture, picture, fail=[rule])


def test_names_in_python_that_went(golden):
    check = partial(golden.check, np.zeros((2, 2)))
    taking = {"RandomDefocus": df.RandomDefocus, "golden.check": check}
    for row, words in rows("python"):
        if row.of in taking:
            with pytest.raises(TypeError, match=row.name) as unknown:
                taking[row.of](**{row.name: 1.0})
            assert str(unknown.value).endswith(words)
            continue
        with pytest.raises(AttributeError, match=row.name) as lacking:
            getattr(df.DefocusLens(50.0, 2.0) if row.of else df, row.name)
        assert str(lacking.value).endswith(words)
        if not row.of:
            with pytest.raises(ImportError, match=row.name) as absent:
                exec(f"from defocus_core import {row.name}")
            assert str(absent.value).endswith(words)
            assert not hasattr(df, row.name)
