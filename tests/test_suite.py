"""Laws of the tests themselves: what may be skipped, and what they do not measure."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
CLOCKS = re.compile(r"\b(perf_counter|process_time|monotonic|thread_time|timeit)\b")
NO_CHROMIUM = (
    "from browser import chromium\n"
    "def test_a_page():\n    with chromium(): pass\n"
    "def test_another():\n    with chromium(): pass\n"
)


@pytest.mark.parametrize(
    ("ci", "code", "words"), [("", 0, "2 skipped:"), ("true", 1, "2 SKIPPED, which fails the run:")]
)
def test_a_program_that_is_missing_fails_a_run_of_ci_alone(ci, code, words, tmp_path):
    (tmp_path / "test_pages.py").write_text(NO_CHROMIUM)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "skips", "-p", "no:cacheprovider", "."]
    environment = {"CI": ci, "PATH": "", "PYTHONPATH": str(TESTS / "support")}
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ran.returncode == code, ran.stdout
    (line,) = (line for line in ran.stdout.splitlines() if "Chromium" in line)
    assert line.startswith(f"{words} needs Chromium; install it")


def test_only_benchmarks_look_at_a_clock():
    """Figures fit one machine; a test that hangs is ended by pytest's ``faulthandler_timeout``."""
    timed = []
    for path in TESTS.rglob("test_*.py"):
        if not CLOCKS.search(text := path.read_text()):
            continue
        tree = ast.parse(text)
        if "pytestmark = pytest.mark.bench" not in ast.unparse(tree):
            functions = [ast.unparse(n) for n in tree.body if isinstance(n, ast.FunctionDef)]
            timed += [text for text in functions if "mark.bench" not in text]
    assert [text for text in timed if CLOCKS.search(text)] == []
