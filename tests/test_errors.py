"""Errors are data: each has a code of the table, and the command line makes one line of it."""

import ast
import pickle
from pathlib import Path

import pytest

from defocus_cli.commands.help import text
from defocus_core.errors import (
    CALLER,
    CODES,
    DefocusError,
    InputError,
    NoteKinds,
    Place,
    with_dashes,
)

ROOT = Path(__file__).parents[1]
SOURCES = sorted(ROOT.glob("defocus_c*/**/*.py"))


def raised(path):
    """Codes of the errors that a module makes, where they are literal."""
    calls = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
    return {
        call.args[0].value
        for call in calls
        if isinstance(call.func, ast.Name)
        and call.func.id in ERRORS
        and call.args
        and isinstance(call.args[0], ast.Constant)
    }


def kinds(kind):
    return {kind.__name__}.union(*(kinds(each) for each in kind.__subclasses__()))


# A refusal of a fit has the code of the error that the command line makes of it.
ERRORS = kinds(DefocusError) | {"NoSpace", "NoDepthChannel", "Refusal"}


def test_each_error_has_a_code_of_the_table_and_each_is_in_use():
    assert set().union(*map(raised, SOURCES)) == CODES.keys()


def test_the_help_has_the_table():
    for code, meaning in CODES.items():
        assert f"| `{code}` | {meaning} |" in text("exit-codes")


def test_an_error_comes_home_from_a_worker_as_it_was():
    error = InputError("damaged", "is damaged", "copy it again", path="a.exr", field="view")
    home = pickle.loads(pickle.dumps(error))
    assert (str(home), vars(home)) == (str(error), vars(error))


def test_options_are_named_in_quotes_and_on_the_command_line_with_dashes():
    error = DefocusError("idle-option", "is idle", "leave ‹blade-rotation› out", field="focus")
    assert (error.field, error.path) == ("focus", None)
    line = "--focus: is idle; leave --blade-rotation out"
    assert with_dashes(str(error)) == line


@pytest.mark.parametrize(
    ("place", "path", "field", "text"),
    [
        (CALLER.at("focus"), None, "focus", "‹focus›"),
        (Place("a.toml", "[lens]", "focus"), "a.toml", "focus", "a.toml: [lens] focus"),
        (Place("a.csv", "line 3", "focus"), "a.csv", "focus", "a.csv: line 3: focus"),
        (Place("a.csv", "line 3"), "a.csv", "line 3", "a.csv: line 3"),
        (Place("a.toml", field="focus"), "a.toml", "focus", "a.toml: focus"),
    ],
)
def test_an_error_has_file_and_key_of_its_place(place, path, field, text):
    error = DefocusError("malformed", "is wrong", path=place)
    assert (error.path, error.field, str(error)) == (path, field, f"{text}: is wrong")


def test_notes_of_one_kind_differ_in_file_numbers_and_units_and_one_is_shown():
    notes = [
        "nothing is in focus at 500mm: 3.2 px",
        "nothing is in focus at 2m: 1 px",
        "b.exr: 1 pixel lost",
        "a.exr: 20 pixels lost",
        "nothing is in focus at 1.5m: 7 px",
    ]
    wanted = {"nothing is in focus at 1.5m: 7 px": 3, "a.exr: 20 pixels lost": 2}
    assert NoteKinds(notes).counts == NoteKinds(reversed(notes)).counts == wanted


def test_a_message_quotes_at_most_200_characters_of_a_path():
    path = f"/{'a' * 5000}/end.exr"
    error = InputError("not-found", f"is not {path}", f"name {path}", path=path)
    assert max(map(len, str(error).split())) <= 201
    assert str(error).count("end.exr") == 3
    assert error.path == path
