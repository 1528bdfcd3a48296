"""Texts for people, durations and shares, and command lines that mean to a shell what they say."""

import shutil
import subprocess
from pathlib import Path

import pytest

from defocus_core.system.text import command_line, duration, percent


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.04, "0.0 s"),
        (2.34, "2.3 s"),
        (42.4, "42 s"),
        (200.0, "3 min 20 s"),
        (7500.0, "2 h 5 min"),
    ],
)
def test_durations_are_told_as_people_do(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("share", "words"), [(1.0, "100 %"), (0.995, "100 %"), (0.031, "3.1 %"), (0.0004, "0.04 %")]
)
def test_shares_are_told_in_percent(share, words):
    assert percent(share) == words


WORDS = ["plain", "a b", "$HOME `id` \"'", "line\nbreak", "tab\tbell\a", "über", "-", "", "\\x41"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="not on this system: no bash")
def test_bash_reads_the_words_as_they_are():
    line = command_line(["printf", "%s\\0", *WORDS, Path("bytes\udcff")])
    ran = subprocess.run(["bash", "-c", line], capture_output=True, check=True)
    wanted = [*(word.encode() for word in WORDS), b"bytes\xff"]
    assert ran.stdout.split(b"\0")[:-1] == wanted


def test_a_command_is_one_line_that_can_be_printed():
    assert command_line(WORDS).isprintable()
