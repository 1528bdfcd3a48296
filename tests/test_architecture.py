"""Arrows point one way, and what is heavy is imported only where it is used."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = sorted((ROOT / "defocus_core").rglob("*.py"))
CLI = sorted((ROOT / "defocus_cli").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

# Folders, and modules beside them, from the outside to the inside: each imports only from those
# below it.
CORE_ORDER = (
    *("__init__", "evaluation", "fitting", "random_lens", "lens_options", "distributions"),
    *("lens", "render", "stream", "engine", "compositing", "blur", "sequences", "depth"),
    *("inpainting", "layers", "images", "optics", "runtime", "renderer_version"),
)
CLI_ORDER = (
    *("__main__", "main", "pytest_plugin", "commands", "options", "html", "bench", "reports"),
    *("golden", "batch", "dataset", "journal", "rendering", "depth", "look", "elements"),
    *("compare", "diagnosis"),
    *("jobs", "lenses", "shots", "depth_formats", "formats", "exr", "system", "__init__"),
)
MOST_LINES, MOST_MODULES, MOST_TESTS = 300, 15, 40
HEAVY = {"torch", "numpy", "OpenEXR", "OpenImageIO", "scipy", "matplotlib", "defocus_core"}
CORE_MAY_USE = {"torch", "defocus_core", *sys.stdlib_module_names}
FILES_AND_WORDS = {
    *("argparse", "io", "json", "logging", "os", "pathlib", "pickle", "shutil", "socket"),
    *("subprocess", "sys", "tempfile", "urllib", "warnings"),
}
# What a module of the core may use all the same: a lens warns of kernels that are cropped, as
# Python warns, and draws them as DeepLens does.
CORE_EXCEPTIONS = {
    "defocus_core/optics/point_spread.py": {"warnings"},
    "defocus_core/optics/psf_map_drawing.py": {"matplotlib"},
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
    return {name for node in ast.walk(tree) for name in imports(node, module(path.parent))}


def on_import(node: ast.AST, package: str) -> Iterator[str]:
    """Modules that importing a module imports: not those of functions, nor of type checkers."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield from imports(child, package)
        yield from on_import(child, package)


def own(path: Path) -> set[str]:
    return {name for name in everywhere(path) if name.split(".")[0] == "defocus_core"}


def place(name: str) -> str:
    """The folder of a module, by its full name; the module itself if it lies beside folders."""
    return ".".join(name.split(".")[1:2]) or "__init__"


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", [*CORE, *CLI], ids=name_of)
def test_arrows_between_folders_go_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    order = CORE_ORDER if package == "defocus_core" else CLI_ORDER
    here = place(module(path))
    assert here in order, f"give {here} its place in the order"
    reached = {place(name) for name in everywhere(path) if name.split(".")[0] == package}
    if package == "defocus_cli":
        reached.discard("__init__")
    assert not {other for other in reached if order.index(other) < order.index(here)}


@pytest.mark.parametrize("paths", [CORE, CLI], ids=["core", "cli"])
def test_no_two_modules_import_each_other(paths: list[Path]) -> None:
    known = {module(path) for path in paths}
    graph = {
        module(path): {name for name in names_imported(path) if name in known} for path in paths
    }
    TopologicalSorter(graph).prepare()  # raises CycleError


def names_imported(path: Path) -> Iterator[str]:
    """Modules that a module imports when it is imported, also as names of their folder."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def folders(paths: list[Path]) -> Iterator[tuple[Path, int]]:
    for folder in sorted({path.parent for path in paths}):
        yield folder, sum(path.parent == folder and path.stem != "__init__" for path in paths)


def test_no_folder_outgrows_fifteen_modules() -> None:
    crowded = {
        str(folder): count
        for folder, count in folders([*CORE, *CLI])
        if count > MOST_MODULES and folder.name != "commands"
    }
    assert not crowded, "it is asking to be two nouns"
    assert not {str(folder) for folder, count in folders(TESTS) if count > MOST_TESTS}


@pytest.mark.parametrize("path", [*CORE, *CLI], ids=name_of)
def test_each_module_says_what_is_in_it(path: Path) -> None:
    text = ast.get_docstring(ast.parse(path.read_text()))
    assert text
    assert text.splitlines()[0].endswith("."), "the first line is a sentence of its own"


@pytest.mark.parametrize("path", CORE, ids=name_of)
def test_the_core_is_pure_torch_without_files_or_prints(path: Path) -> None:
    roots = {name.split(".")[0] for name in everywhere(path)}
    roots -= CORE_EXCEPTIONS.get(name_of(path), set())
    assert roots <= CORE_MAY_USE
    assert not roots & FILES_AND_WORDS
    calls = {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not calls & {"open", "print", "input", "exec", "eval"}


@pytest.mark.parametrize("path", CLI, ids=name_of)
def test_the_command_line_imports_what_is_heavy_inside_functions(path: Path) -> None:
    names = on_import(ast.parse(path.read_text()), module(path.parent))
    assert not {name.split(".")[0] for name in names} & HEAVY


@pytest.mark.parametrize("path", CLI, ids=name_of)
def test_the_command_line_uses_what_the_core_exports(path: Path) -> None:
    private = own(path) - {"defocus_core"}
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


@pytest.mark.parametrize("path", [*CORE, *CLI], ids=name_of)
def test_no_module_outgrows_three_hundred_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MOST_LINES, "it is asking to be two nouns"
