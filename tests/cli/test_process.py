"""How the process of a command begins and ends."""

import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress

import pytest
from batches import jobs_file
from command_line import LENS, depth_exr, pair, succeed

from defocus_cli import main


def ended(code, *words):
    command = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


RUN = "from defocus_cli.__main__ import run; run()"


@pytest.mark.parametrize(
    ("words", "code"), [(["--version"], 0), (["rendr"], 2), (["info", "missing.exr"], 3)]
)
def test_a_process_ends_with_the_exit_code_of_the_command(words, code):
    assert ended(RUN, *words).returncode == code


CODECS = ("OpenEXR", "OpenImageIO", "scipy", "matplotlib", "distributed", "pandas", "torch")
STEPS = """
import json, sys
from importlib import import_module
for code, *banned in json.load(sys.stdin):
    exec(code)
    if loaded := sorted({*sys.modules} & {*banned}):
        sys.exit(f"{code}: {loaded}")
"""


def test_what_is_heavy_is_loaded_by_what_needs_it_alone(tmp_path):
    """In one process, which does more and more."""
    (color, depth), jobs, out = pair(tmp_path, "a"), jobs_file(tmp_path, "a"), tmp_path / "out"
    succeed("batch", jobs, "-o", out)
    drawn = ("--diff", tmp_path / "d", "--junit", tmp_path / "x.xml", "--html", tmp_path / "x.html")
    commands = [
        (("--help",), ("numpy", *CODECS)),
        (("help", "depth"), ("numpy", *CODECS)),
        (("render", "--help"), CODECS),
        (("render", color, depth, "-o", tmp_path / "r", "--dry-run", "--focus", "2"), CODECS),
        (("batch", jobs, "-o", out), CODECS),
        (("render", color, depth, "-o", tmp_path / "r"), ("torch",)),
        (("info", depth), ("torch",)),
        (("compare", color, depth, "--json", *drawn), ("torch",)),
        (("compare", out, out), ("torch",)),
    ]
    steps = [
        ("import defocus_core; from defocus_cli.main import COMMANDS, main", "numpy", *CODECS),
        *((f"main({list(map(str, words))!r})", *banned) for words, banned in commands[:2]),
        ("for name in COMMANDS: import_module(f'defocus_cli.commands.{name}')", *CODECS),
        *((f"main({list(map(str, words))!r})", *banned) for words, banned in commands[2:]),
        (f"defocus_core.read_color({str(color)!r}); defocus_core.samples({str(out)!r})", "torch"),
        (f"defocus_core.compare_images({str(color)!r}, {str(color)!r})", "torch"),
    ]
    command = [sys.executable, "-c", STEPS]
    ran = subprocess.run(command, input=json.dumps(steps), capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr


def test_nothing_is_said_to_who_has_gone(tmp_path):
    color, depth = pair(tmp_path)
    rendering = ["render", color, depth, *LENS, "-o", tmp_path / "out", "--outputs", "coc"]
    for words in (["--help"], ["info", color], [*rendering, "--json"]):
        reader, writer = os.pipe()
        os.close(reader)
        err = io.StringIO()
        with suppress(BrokenPipeError), os.fdopen(writer, "w") as gone:
            streams = redirect_stdout(gone), redirect_stderr(err)
            with streams[0], streams[1]:
                code = main.main(list(map(str, words)))
        assert code == 141
        assert err.getvalue().count("\n") == (words[0] == "render"), err.getvalue()
    assert (tmp_path / "out" / "coc" / "a.exr").exists()
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-c", RUN, "info", str(color), "--json"]
    ran = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (ran.returncode, ran.stderr) == (141, "")


def test_a_limit_of_the_shell_is_known_and_told(tmp_path):
    """'ulimit -v': less than torch's library needs, and enough for a picture."""
    files = [str(file) for file in pair(tmp_path)]
    limit = "import resource as r; r.setrlimit(r.RLIMIT_AS, ({0}, {0}))\n"
    ran = ended(limit.format(45 * 10**7) + RUN, "render", *files, "-o", tmp_path / "a", *LENS)
    assert (ran.returncode, "report" in ran.stderr) == (3, False), ran.stderr
    assert ran.stderr.startswith("defocus: memory: the system gives no more memory: ")
    told = "from defocus_core.system.memory import available_mb; print(available_mb())"
    assert 100 < float(ended(limit.format(10**9) + told).stdout) < 1000


def pressing(module):
    """A program that presses Ctrl-C as soon as a module is imported."""
    return (
        "import os, signal, sys\n"
        "class Pressing:\n"
        "    def find_spec(self, name, path, target=None):\n"
        f"        if name == {module!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Pressing())\n"
    )


def test_ctrl_c_while_the_command_line_is_imported_is_no_traceback():
    ran = ended(pressing("click") + RUN, "--version")
    assert (ran.returncode, ran.stdout, ran.stderr) == (130, "", "defocus: interrupted\n")


@pytest.mark.parametrize("module", ["defocus_core.request.job", "numpy._core.getlimits"])
def test_ctrl_c_within_an_import_of_a_command_ends_it_alike(module, tmp_path):
    ran = ended(pressing(module) + RUN, "info", depth_exr(tmp_path / "a.exr"))
    assert ran.returncode == 130, ran.stderr
    assert ran.stderr.startswith("defocus: interrupted")
