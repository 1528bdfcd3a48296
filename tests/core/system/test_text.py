"""Command lines that mean to a shell what they say."""

import shutil
import subprocess
from pathlib import Path

import pytest

from defocus_core.system.text import command_line

WORDS = ["plain", "a b", "$HOME `id` \"'", "line\nbreak", "tab\tbell\a", "über", "-", "", "\\x41"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="not on this system: no bash")
def test_bash_reads_the_words_as_they_are():
    line = command_line(["printf", "%s\\0", *WORDS, Path("bytes\udcff")])
    ran = subprocess.run(["bash", "-c", line], capture_output=True, check=True)
    wanted = [*(word.encode() for word in WORDS), b"bytes\xff"]
    assert ran.stdout.split(b"\0")[:-1] == wanted


def test_a_command_is_one_line_that_can_be_printed():
    assert command_line(WORDS).isprintable()
