"""Options mean the same wherever they stand, and say what they take."""

import os
import re
from importlib import import_module

import click
import pytest
from command_line import run

from defocus_cli.commands.depth import command as depth_command
from defocus_cli.commands.help import TOPICS, text
from defocus_cli.commands.info import command as info
from defocus_cli.commands.render import command as render_command
from defocus_cli.main import COMMANDS
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.reading_options import READING_OPTIONS
from defocus_core.system.process import cores


def test_threads_are_the_cores_this_process_may_use():
    assert cores() == len(os.sched_getaffinity(0))


@pytest.mark.parametrize("command", [info, render_command])
def test_every_lens_option_is_a_flag_of_every_command_that_takes_a_lens(command):
    flags = {name for param in command.params for name in param.opts}
    assert {f"--{name}" for name in LENS_OPTIONS} | {"--lens"} <= flags


def test_every_lens_option_stands_in_a_topic_of_the_help():
    topics = "".join(text(topic) for topic in TOPICS)
    assert [name for name in LENS_OPTIONS if f"--{name}" not in topics] == []


@pytest.mark.parametrize("command", [info, render_command, depth_command])
def test_every_reading_option_is_a_flag_of_every_command_that_reads_depth(command):
    flags = {name for param in command.params for name in param.opts}
    of_color = {
        *("--color-layer", "--blur-channels", "--resize-depth", "--unpremultiply-depth"),
        *("--depth-repair", "--edge-width", "--invert", "--turn-depth"),
    }
    of_color = of_color if command is depth_command else set()
    assert {f"--{name}" for name in READING_OPTIONS} - of_color <= flags
    assert not of_color & flags


@pytest.mark.parametrize("name", COMMANDS)
def test_short_help_shows_what_most_need_and_names_topics_of_the_rest(name):
    command = import_module(f"defocus_cli.commands.{name}").command
    short, whole = run(name, "--help").out, run(name, "--help-all").out
    left_out = []
    for param in command.params:
        if isinstance(param, click.Option) and not param.hidden:
            word = re.escape(max(param.opts, key=len)) + r"(?![\w-])"
            shown = rf"(?m)^  (-\w, )?{word}"
            assert re.search(shown, whole)
            left_out += [] if re.search(shown, short) else [(word, param.heading)]
    assert len(re.findall(r"(?m)^  -", short)) <= 26
    for word, heading in left_out:
        listed = re.search(rf"(?m)^  {heading} +\d+ more: (.*(\n {{4}}.*)*)", short)[1]
        topics = re.findall(r"help\s+(\w+)", listed)
        assert any(re.search(word, text(topic)) for topic in topics), (word, topics)


def test_help_shows_options_under_their_headings():
    text = run("render", "--help-all").out
    places = [text.index(f"\n{heading}:") for heading in ("Lens", "Output", "Files", "Machine")]
    assert places == sorted(places)
    assert text.index("--focal-length") < text.index("\nOutput:") < text.index("--overwrite")
    assert "Examples:" in text
