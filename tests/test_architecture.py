"""Laws of the structure: arrows point one way; what is heavy is imported where it is used."""

import ast
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = sorted((ROOT / "defocus_core").rglob("*.py"))
CLI = sorted((ROOT / "defocus_cli").rglob("*.py"))

# From the outside to the inside: each imports only from those below it.
TORCH = ("fitting", "sequences", "evaluation", "renderer", "depth", "optics", "tensors")
FILES = ("io", "system", "errors", "renderer_version")  # torch and files do not know each other
ORDER = ("pytest_plugin", "reports", "bench", "compare", "batch", *TORCH, *FILES, "allowed_values")
CLI_ORDER = ("__main__", "main", "commands", "options", "words", "__init__")
HEAVY = {"torch", "numpy", "OpenEXR", "OpenImageIO", "scipy", "matplotlib"}
TORCH_MAY_USE = {"torch", "defocus_core", *sys.stdlib_module_names}
FILES_AND_WORDS = {
    *("argparse", "io", "json", "logging", "os", "pathlib", "pickle", "shutil", "socket"),
    *("subprocess", "sys", "tempfile", "urllib", "warnings"),
}
# What a module of torch may use all the same: a lens warns of kernels that are cropped, as Python
# warns, and draws them as DeepLens does.
TORCH_EXCEPTIONS = {
    "defocus_core/optics/point_spread.py": {"warnings"},
    "defocus_core/renderer/defocus_lens.py": {"warnings"},
    "defocus_core/optics/psf_map_drawing.py": {"matplotlib"},
}
LONGEST_FUNCTION = 60  # lines, without those of its docstring
TOP_LEVEL = {
    *("pyproject.toml", "Makefile", "README.md"),
    *("defocus_cli", "defocus_core", "sample_scenes", "tests"),
}


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def wing(name: str) -> str:
    """The folder of a module, by its full name; the module itself if it lies beside folders."""
    return ".".join(name.split(".")[1:2]) or "__init__"


TORCH_MODULES = [path for path in CORE if wing(module(path)) in TORCH]
# Its class is one of torch's; it is imported when its name is touched.
OF_TORCH = {"defocus_core/batch/datasets/torch_dataset.py"}
OF_ANY_ARRAYS = ("defocus_core.evaluation.similarity",)  # without torch until it is given some
LIGHT = [p for p in (*CORE, *CLI) if p not in TORCH_MODULES and name_of(p) not in OF_TORCH]
KNOWN = {module(path) for path in (*CORE, *CLI)}


@cache
def tree(path: Path) -> ast.Module:
    """The module, parsed once for all laws."""
    return ast.parse(path.read_text())


def broken(paths: Iterable[Path], faults: Callable[[Path], Iterable[object]]) -> dict[str, object]:
    """The faults of each module that has some."""
    found = {name_of(path): list(faults(path)) for path in paths}
    return {name: each for name, each in found.items() if each}


def names(node: ast.AST) -> Iterator[str]:
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
def everywhere(path: Path) -> frozenset[str]:
    """Modules that a module imports, in functions and for type checkers, too."""
    return frozenset(name for node in ast.walk(tree(path)) for name in names(node))


def on_import(node: ast.AST) -> Iterator[str]:
    """Modules that importing a module imports: not those of functions, nor of type checkers."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield from names(child)
        yield from on_import(child)


def may_import(importer: str, imported: str) -> bool:
    """Whether a wing of the library may import from another."""
    if importer in TORCH and imported in FILES:
        return False
    return imported in ORDER and ORDER.index(importer) <= ORDER.index(imported)


def test_arrows_of_the_library_go_one_way() -> None:
    def wrong_way(path: Path) -> Iterator[str]:
        importer = wing(module(path))
        assert importer in ORDER, f"give {importer} its place in the order"
        own = {name for name in everywhere(path) if name.split(".")[0].startswith("defocus_")}
        # the library knows no commands
        yield from (name for name in own if not name.startswith("defocus_core."))
        yield from (name for name in own if not may_import(importer, wing(name)))

    door = ROOT / "defocus_core" / "__init__.py"  # to all names
    assert broken((path for path in CORE if path != door), wrong_way) == {}


def test_arrows_of_the_command_line_go_one_way() -> None:
    def wrong_way(path: Path) -> Iterator[str]:
        importer = CLI_ORDER.index(wing(module(path)))
        reached = {wing(name) for name in everywhere(path) if name.startswith("defocus_cli.")}
        yield from (other for other in reached if CLI_ORDER.index(other) < importer)

    assert broken(CLI, wrong_way) == {}


def test_the_library_does_not_parse_command_lines() -> None:
    def of_click(path: Path) -> Iterator[str]:
        yield from (name for name in everywhere(path) if name.split(".")[0] == "click")

    assert broken(CORE, of_click) == {}


def test_no_modules_import_each_other_in_a_circle() -> None:
    paths = [*CORE, *CLI]
    graph = {module(path): (everywhere(path) & KNOWN) - {module(path)} for path in paths}
    TopologicalSorter(graph).prepare()  # raises CycleError


def test_no_two_classes_have_one_name() -> None:
    places: dict[str, list[str]] = {}
    for path in (*CORE, *CLI):
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name_of(path))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function but for its docstring, which may need as many as it needs."""
    lines = (function.end_lineno or 0) - function.lineno + 1
    first = function.body[0]
    return lines - (
        (first.end_lineno or 0) - first.lineno + 1 if ast.get_docstring(function) else 0
    )


def test_functions_are_short() -> None:
    def too_long(path: Path) -> Iterator[str]:
        for node in ast.walk(tree(path)):
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if is_function and length(node) > LONGEST_FUNCTION:
                yield f"{node.name}: {length(node)} lines"

    assert broken([*CORE, *CLI], too_long) == {}


def test_each_module_says_what_is_in_it() -> None:
    def without_sentence(path: Path) -> Iterator[str]:
        first = (ast.get_docstring(tree(path)) or "").partition("\n")[0]
        if not first.endswith("."):
            yield f"{first!r} is no sentence of its own"

    assert broken([*CORE, *CLI], without_sentence) == {}


def test_what_computes_is_pure_torch_without_files_or_prints() -> None:
    def impure(path: Path) -> Iterator[str]:
        roots = {name.split(".")[0] for name in everywhere(path)}
        roots -= TORCH_EXCEPTIONS.get(name_of(path), set())
        yield from (roots - TORCH_MAY_USE) | (roots & FILES_AND_WORDS)
        calls = (node.func for node in ast.walk(tree(path)) if isinstance(node, ast.Call))
        called = {func.id for func in calls if isinstance(func, ast.Name)}
        yield from called & {"open", "print", "input", "exec", "eval"}

    assert broken(TORCH_MODULES, impure) == {}


def test_what_is_heavy_is_imported_inside_functions() -> None:
    def heavy_of(path: Path) -> Iterator[str]:
        reached = set(on_import(tree(path)))
        # Pixels are held by numpy; help must not reach the modules that do, as is tested below.
        heavy = HEAVY - ({"numpy"} if path in CORE else set())
        ours = {name for name in reached if name.startswith("defocus_core.")}
        ours = {name for name in ours if not name.startswith(OF_ANY_ARRAYS)}
        yield from (name for name in reached if name.split(".")[0] in heavy)
        yield from (name for name in ours if wing(name) in TORCH)

    assert broken(LIGHT, heavy_of) == {}


@pytest.mark.parametrize(
    "start",
    [
        "import defocus_core",
        "import defocus_cli.main",
        "from defocus_cli.main import main; main(['--help'])",
        "from defocus_cli.main import main; main(['help', 'depth'])",
    ],
)
def test_nothing_heavy_is_imported_at_the_start(start: str) -> None:
    code = f"{start}; import sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(ran.stdout.split()) & HEAVY


def test_commands_import_no_torch_and_no_codecs() -> None:
    code = (
        "import importlib, sys; from defocus_cli.main import COMMANDS\n"
        "for name in COMMANDS: importlib.import_module(f'defocus_cli.commands.{name}')\n"
        "print(*sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(ran.stdout.split()) & (HEAVY - {"numpy"})


def test_the_top_level_holds_what_was_agreed() -> None:
    try:
        listed = subprocess.run(
            ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not on this system: no checkout of git")
    visible = {name.split("/")[0] for name in listed if not name.startswith(".")}
    assert visible <= TOP_LEVEL
