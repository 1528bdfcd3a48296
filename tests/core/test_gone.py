"""What went is refused wherever it is written, with the words that replace it: row by row."""

from importlib.metadata import version

import pytest
from command_line import failed, run

import defocus_core
from defocus_cli.main import COMMANDS
from defocus_cli.options.shared import GroupedOption, Words
from defocus_core import DefocusLens, RandomDefocus, UsageProblem
from defocus_core.compare.thresholds import rule, rules_like
from defocus_core.errors import Place, with_dashes
from defocus_core.gone import GONE
from defocus_core.request.quantities import QuantityError, one_of, read_at
from defocus_core.request.toml_file import refuse_unknown
from defocus_core.tensors.validation import one_of as one_of_arguments

ROWS = [(row, since) for since, rows in GONE.items() for row in rows]
KINDS = ("option", "key", "value", "rule", "command", "python")


def rows(kind):
    """The rows of a kind, each with the end of its error."""
    for row, since in ROWS:
        if row.kind == kind:
            yield row, f"it went with {since}: {row.instead}"


def test_rows_stay_for_two_versions():
    major, minor, *_ = map(int, version("defocus").split("."))
    assert {*GONE} <= {f"{major}.{minor}.0", f"{major}.{minor - 1}.0"}


def test_each_row_has_a_kind_and_stands_once():
    names = [(row.kind, row.name, row.of) for row, _ in ROWS]
    assert {kind for kind, _, _ in names} <= {*KINDS}
    assert len(names) == len(set(names))


def test_commands_that_went():
    for row, words in rows("command"):
        ran = run(row.name, "out")
        failed(ran, 2, "unknown-name", row.name)
        assert with_dashes(words) in ran.err


def test_options_that_went():
    for row, words in rows("option"):
        for command in (row.of,) if row.of else COMMANDS:
            ran = run(command, f"--{row.name}")
            failed(ran, 2, None, row.name)
            assert with_dashes(words) in ran.err


def test_keys_that_went():
    for row, words in [
        *rows("key"),
        *((row, words) for row, words in rows("option") if not row.of),
    ]:
        with pytest.raises(UsageProblem) as error:
            refuse_unknown([row.name], ("color",), Place("jobs.toml"), row.of or "[lens]")
        assert error.value.remedy == words


def test_values_that_went():
    for row, words in rows("value"):
        field = row.of.replace("-", "_")
        with pytest.raises(UsageProblem) as error:
            read_at(Place("jobs.toml", field=row.of), one_of(("standard",)), row.name)
        assert error.value.remedy == words
        with pytest.raises(UsageProblem) as chosen:
            Words(["standard"]).convert(row.name, GroupedOption([f"--{row.of}"]), None)
        assert chosen.value.remedy == words
        with pytest.raises(ValueError, match=field) as refused:
            one_of_arguments(field, row.name, ("standard",))
        assert str(refused.value).endswith(words)


def test_rules_of_compare_that_went():
    for row, words in rows("rule"):
        with pytest.raises(QuantityError) as error:
            rule(row.name if ":" in row.name else f"{row.name}<1")
        assert error.value.remedy == words


def bounded(**bounds):
    rules_like(None, bounds)


def test_names_in_python_that_went():
    for row, words in rows("python"):
        if row.of == "DefocusLens":
            with pytest.raises(AttributeError, match=row.name) as lacking:
                getattr(DefocusLens(50.0, 2.0), row.name)
            assert str(lacking.value).endswith(words)
            continue
        if row.of:
            taking = {"RandomDefocus": RandomDefocus, "golden.check": bounded}[row.of]
            with pytest.raises(TypeError, match=row.name) as unknown:
                taking(**{row.name: 1.0})
            assert str(unknown.value).endswith(words)
            continue
        with pytest.raises(AttributeError, match=row.name) as lacking:
            getattr(defocus_core, row.name)
        assert str(lacking.value).endswith(words)
        with pytest.raises(ImportError, match=row.name) as absent:
            exec(f"from defocus_core import {row.name}")
        assert str(absent.value).endswith(words)
        assert not hasattr(defocus_core, row.name)
