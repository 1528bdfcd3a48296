"""Laws of the structure: arrows point one way; what is heavy is imported where it is used."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = sorted((ROOT / "defocus_core").rglob("*.py"))
CLI = sorted((ROOT / "defocus_cli").rglob("*.py"))

# From the outside to the inside: each imports only from those below it.
TORCH = ("fitting", "evaluation", "renderer", "depth", "optics", "tensors")
FILES = ("io", "system", "errors", "renderer_version")  # torch and files do not know each other
ABOVE = ("pytest_plugin", "reports", "bench", "compare", "batch", "picture", "request")
ORDER = (*ABOVE, *TORCH, *FILES, "gone", "allowed_values")
CLI_ORDER = ("__main__", "main", "commands", "options", "words", "__init__")
HEAVY = {"torch", "numpy", "OpenEXR", "OpenImageIO", "scipy", "matplotlib"}
TORCH_MAY_USE = {"torch", "defocus_core", *sys.stdlib_module_names}
FILES_AND_WORDS = {
    *("argparse", "io", "json", "logging", "os", "pathlib", "pickle", "shutil", "socket"),
    *("subprocess", "sys", "tempfile", "urllib", "warnings"),
}
# What a module of torch may use all the same: a lens warns of kernels that are cropped, as Python
# warns; compiled functions are kept in files, and that they are compiled is said.
TORCH_EXCEPTIONS = {
    "defocus_core/optics/point_spread.py": {"warnings"},
    "defocus_core/renderer/defocus_lens.py": {"warnings"},
    "defocus_core/renderer/compiled/once.py": {"logging"},
    "defocus_core/tensors/later.py": {"sys"},
    "defocus_core/renderer/compiled/kept.py": {"filelock", "os", "pathlib", "sys", "tempfile"},
}
COMPILED = {"numpy", "numba"}  # what functions in renderer/compiled are of
LONGEST_FUNCTION = 60  # lines, without those of its docstring
TOP_LEVEL = {
    *("pyproject.toml", "Makefile", "README.md"),
    *("defocus_cli", "defocus_core", "sample_scenes", "tests"),
}


@cache
def parsed(path):
    return ast.parse(path.read_text())


def module(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def name_of(path):
    return str(path.relative_to(ROOT))


def wing(name):
    """The folder of a module, by its full name; the module itself if it lies beside folders."""
    return ".".join(name.split(".")[1:2]) or "__init__"


TORCH_MODULES = [path for path in CORE if wing(module(path)) in TORCH]
# Its class is one of torch's; it is imported when its name is touched.
OF_TORCH = {"defocus_core/batch/datasets/torch_dataset.py"}
OF_ANY_ARRAYS = ("defocus_core.evaluation.similarity",)  # without torch until it is given some
LIGHT = [p for p in (*CORE, *CLI) if p not in TORCH_MODULES and name_of(p) not in OF_TORCH]
KNOWN = {module(path) for path in (*CORE, *CLI)}


def nodes(path, *kinds):
    """Of some kinds in a module."""
    return [node for node in ast.walk(parsed(path)) if isinstance(node, kinds)]


def names(node):
    """Full names of the modules that a statement imports."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert not node.level, "imports are absolute"
        base = node.module or ""
        for alias in node.names:
            full = f"{base}.{alias.name}"
            yield full if full in KNOWN else base


@cache
def everywhere(path):
    """Modules that a module imports, in functions and for type checkers, too."""
    return {name for node in ast.walk(parsed(path)) for name in names(node)}


def on_import(node):
    """Modules that importing a module imports: not those of functions, nor of type checkers."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield from names(child)
        yield from on_import(child)


def of_each(paths):
    """A law of files as one test, which names those that break it."""

    def looped(law):
        def test():
            broken = {}
            for path in paths:
                try:
                    law(path)
                except AssertionError as error:
                    broken[name_of(path)] = str(error)
            assert broken == {}

        return test

    return looped


def may_import(importer, imported):
    """Whether a wing of the library may import from another."""
    if importer in TORCH and imported in FILES:
        return False
    return imported in ORDER and ORDER.index(importer) <= ORDER.index(imported)


@of_each(CORE)
def test_arrows_of_the_library_go_one_way(path):
    if module(path) == "defocus_core":
        return  # the door to all names
    importer = wing(module(path))
    assert importer in ORDER, f"give {importer} its place in the order"
    own = {name for name in everywhere(path) if name.split(".")[0].startswith("defocus_")}
    assert all(name.startswith("defocus_core.") for name in own), "the library knows no commands"
    assert {name for name in own if not may_import(importer, wing(name))} == set()


@of_each(CLI)
def test_arrows_of_the_command_line_go_one_way(path):
    order, importer = CLI_ORDER, wing(module(path))
    reached = {wing(name) for name in everywhere(path) if name.startswith("defocus_cli.")}
    assert not {other for other in reached if order.index(other) < order.index(importer)}


@of_each(CORE)
def test_the_library_does_not_parse_command_lines(path):
    assert "click" not in {name.split(".")[0] for name in everywhere(path)}


def test_no_modules_import_each_other_in_a_circle():
    paths = [*CORE, *CLI]
    graph = {module(path): (everywhere(path) & KNOWN) - {module(path)} for path in paths}
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_no_two_classes_have_one_name():
    places: dict[str, list[str]] = {}
    for path in (*CORE, *CLI):
        for node in nodes(path, ast.ClassDef):
            places.setdefault(node.name, []).append(name_of(path))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def length(function):
    """Lines of a function but for its docstring, which may need as many as it needs."""
    told = function.body[:1] if ast.get_docstring(function) else []
    whole, *without = ((node.end_lineno or 0) - node.lineno + 1 for node in (function, *told))
    return whole - sum(without)


@of_each([*CORE, *CLI])
def test_functions_are_short(path):
    functions = nodes(path, ast.FunctionDef, ast.AsyncFunctionDef)
    lines = {each.name: length(each) for each in functions}
    assert {name: count for name, count in lines.items() if count > LONGEST_FUNCTION} == {}


@of_each([*CORE, *CLI])
def test_each_module_says_what_is_in_it(path):
    text = ast.get_docstring(parsed(path))
    assert text
    assert text.splitlines()[0].endswith("."), "the first line is a sentence of its own"


@of_each(TORCH_MODULES)
def test_what_computes_is_pure_torch_without_files_or_prints(path):
    roots = {name.split(".")[0] for name in everywhere(path)}
    roots -= TORCH_EXCEPTIONS.get(name_of(path), set())
    roots -= COMPILED if path.parent.name == "compiled" else set()
    assert roots <= TORCH_MAY_USE
    assert not roots & FILES_AND_WORDS
    called = (node.func for node in nodes(path, ast.Call))
    calls = {function.id for function in called if isinstance(function, ast.Name)}
    assert not calls & {"open", "print", "input", "exec", "eval"}


@of_each(LIGHT)
def test_what_is_heavy_is_imported_inside_functions(path):
    reached = set(on_import(parsed(path)))
    # Pixels are held by numpy; help must not reach the modules that do, as is tested below.
    heavy = HEAVY - ({"numpy"} if path in CORE else set())
    assert not {name.split(".")[0] for name in reached} & heavy
    ours = {name for name in reached if name.startswith("defocus_core.")}
    assert not {wing(name) for name in ours if not name.startswith(OF_ANY_ARRAYS)} & {*TORCH}


def test_the_top_level_holds_what_was_agreed():
    try:
        listed = subprocess.run(
            ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not on this system: no checkout of git")
    visible = {name.split("/")[0] for name in listed if not name.startswith(".")}
    assert visible <= TOP_LEVEL
