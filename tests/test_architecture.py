"""Arrows point one way, and what is heavy is imported only where it is used."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = sorted((ROOT / "defocus_core").glob("*.py"))
CLI = sorted((ROOT / "defocus_cli").rglob("*.py"))

# From the outside to the inside: a module imports from its own row or the rows below it.
LAYERS = [
    {"__init__"},
    {"random_lens"},
    {"lens", "planning", "verification"},
    {"agreement"},
    {"checks"},
    {"render", "stream"},
    {"picture"},
    {"enlarging"},
    {"assembly"},
    {"baselines", "copying", "presence", "region", "workload"},
    {"order"},
    {"detail", "filling", "fronts"},
    {"half_size"},
    {"blur", "frame"},
    {"octaves"},
    {"borders", "known", "reduced"},
    {"discs", "hidden", "surface", "windows"},
    {"backdrop", "shifts", "survey"},
    {"continuation", "mending", "transport", "view"},
    {"highlights", "obstruction", "soft_edges"},
    {
        "antialiased",
        "compositing",
        "convolution",
        "mended",
        "mixed",
        "noise",
        "points",
        "ramps",
        "sheets",
        "slicing",
        "terraces",
    }
    | {"thin_lens"},
    {
        "aperture",
        "derived",
        "distributions",
        "ends",
        "masks",
        "neighbours",
        "halving",
        "metrics",
        "patches",
        "planes",
        "probes",
        "quality",
        "ranks",
        "reach",
        "recomputed",
        "resampling",
        "scenery",
        "sensor",
        "slopes",
        "threads",
    },
    {"views"},
    {"guards", "modes", "outline", "ties", "tiling"},
    {"source", "spans"},
]
HEAVY = {"torch", "numpy", "OpenEXR", "OpenImageIO", "scipy", "matplotlib", "defocus_core"}
# Modules of the core that the command line still imports by their names.
STILL_PRIVATE = {
    f"defocus_core.{name}" for name in ("metrics", "planning", "scenery", "source", "threads")
}
CORE_MAY_USE = {"torch", "defocus_core", *sys.stdlib_module_names}
FILES_AND_WORDS = {
    *("argparse", "io", "json", "logging", "os", "pathlib", "pickle", "shutil", "socket"),
    *("subprocess", "sys", "tempfile", "urllib", "warnings"),
}
TOP_LEVEL = {
    *("pyproject.toml", "Makefile", "README.md"),
    *("defocus_cli", "defocus_core", "sample_scenes", "tests"),
}


def imports(node: ast.AST, package: str) -> Iterator[str]:
    """Full names of the modules that a statement imports."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = ".".join(package.split(".")[: -node.level + 1 or None]) if node.level else ""
        yield ".".join(filter(None, [base, node.module]))


def everywhere(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    return {name for node in ast.walk(tree) for name in imports(node, path.parent.name)}


def on_import(node: ast.AST, package: str) -> Iterator[str]:
    """Modules that importing a module imports: not those of functions, nor of type checkers."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield from imports(child, package)
        yield from on_import(child, package)


def neighbours(path: Path) -> set[str]:
    """Modules of the core that a module of the core imports."""
    names = (name.removeprefix("defocus_core").lstrip(".") for name in own(path))
    return {name or "__init__" for name in names}


def own(path: Path) -> set[str]:
    return {name for name in everywhere(path) if name.split(".")[0] == "defocus_core"}


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.stem)
def test_the_core_imports_downwards(path: Path) -> None:
    level = {name: i for i, row in enumerate(LAYERS) for name in row}
    assert path.stem in level, f"give {path.stem} its place in LAYERS"
    upwards = {name for name in neighbours(path) if level[name] < level[path.stem]}
    assert not upwards


def test_no_two_modules_of_the_core_import_each_other() -> None:
    graph = {path.stem: neighbours(path) for path in CORE}
    TopologicalSorter(graph).prepare()  # raises CycleError
    assert not [name for name, imported in graph.items() if "__init__" in imported]


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.stem)
def test_the_core_is_pure_torch_without_files_or_prints(path: Path) -> None:
    roots = {name.split(".")[0] for name in everywhere(path)}
    assert roots <= CORE_MAY_USE
    assert not roots & FILES_AND_WORDS
    calls = {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not calls & {"open", "print", "input", "exec", "eval"}


@pytest.mark.parametrize("path", CLI, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_command_line_imports_what_is_heavy_inside_functions(path: Path) -> None:
    names = on_import(ast.parse(path.read_text()), path.parent.name)
    assert not {name.split(".")[0] for name in names} & HEAVY


@pytest.mark.parametrize("path", CLI, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_command_line_uses_what_the_core_exports(path: Path) -> None:
    private = own(path) - {"defocus_core"} - STILL_PRIVATE
    assert not private, "export what is needed in defocus_core/__init__.py"


def test_the_command_line_starts_without_what_is_heavy() -> None:
    code = "import defocus_cli.main, sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(ran.stdout.split()) & HEAVY


def test_the_top_level_holds_what_was_agreed() -> None:
    try:
        listed = subprocess.run(
            ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout")
    visible = {name.split("/")[0] for name in listed if not name.startswith(".")}
    assert visible <= TOP_LEVEL


@pytest.mark.parametrize("path", [*CORE, *CLI], ids=lambda path: str(path.relative_to(ROOT)))
def test_no_module_outgrows_three_hundred_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 300, "it is asking to be two nouns"
