"""Options mean the same wherever they stand, and say what they take."""

import os
import re
import subprocess
import sys
from importlib import import_module

import click
import pytest
from command_line import pair, run, topic

from defocus_cli.main import COMMANDS
from defocus_core.request.job_options import READING_OPTIONS
from defocus_core.request.parameters import BLURRING, LENS_OPTIONS
from defocus_core.system.process import cores


def test_threads_are_the_cores_this_process_may_use():
    assert cores() == len(os.sched_getaffinity(0))


def command_of(name):
    return import_module(f"defocus_cli.commands.{name}").command


def flags_of(name):
    return {flag for param in command_of(name).params for flag in param.opts}


@pytest.mark.parametrize(
    ("command", "without"),
    [
        ("render", ()),
        ("info", {*LENS_OPTIONS} - {*BLURRING} | {"blur-channels", "resize-depth", "animate"}),
        ("choose", ("dp-model", "dp-crosstalk", "animate", "quality", "blur-channels")),
    ],
)
def test_a_command_has_the_options_of_what_it_shows(command, without):
    flags, shared = flags_of(command), {*LENS_OPTIONS, *READING_OPTIONS, "lens"}
    assert {f"--{name}" for name in shared - {*without}} <= flags
    assert not {f"--{name}" for name in without} & flags


@pytest.mark.parametrize("name", BLURRING)
def test_every_lens_option_of_info_changes_the_blur_it_tells(name, tmp_path):
    files, row = pair(tmp_path), LENS_OPTIONS[name]
    others = {"focus-at": "0,0", "focus-value": "2", "clamp-blur": "0.1px", "sharp-range": "2m..9m"}
    value = others.get(name, {"50mm": "60mm", "36mm": "20mm", "2m": "1.5m"}.get(row.example, "2.8"))
    lens = {"focal-length": "50mm", "fnumber": "2", "focus": "3m"}
    if name in ("blur", "focus-value"):
        lens, value = {"blur": "9px", "focus-value": "3"}, {"blur": "8px"}.get(name, value)

    def told(options):
        words = [word for key, text in options.items() for word in (f"--{key}", text)]
        return run("info", "--json", *files, *words).json["files"][1]["depth"]["coc_px"]

    changed = {key: text for key, text in lens.items() if key != row.instead_of} | {name: value}
    assert told(changed) != told(lens)


def test_every_lens_option_stands_in_a_topic_of_the_help():
    topics = "".join(topic(line.split()[0]) for line in run("help").out.splitlines())
    assert [name for name in LENS_OPTIONS if f"--{name}" not in topics] == []


def test_depth_has_the_reading_options_of_a_depth_file_alone():
    of_color = {
        *("--color-layer", "--blur-channels", "--resize-depth"),
        *("--depth-repair", "--edge-width", "--invert"),
    }
    assert {f"--{name}" for name in READING_OPTIONS} - flags_of("depth") == of_color


@pytest.mark.parametrize("name", COMMANDS)
def test_short_help_shows_what_most_need_and_names_topics_of_the_rest(name):
    short, whole = run(name, "--help").out, run(name, "--help-all").out
    left_out = []
    for param in command_of(name).params:
        if isinstance(param, click.Option) and not param.hidden:
            word = re.escape(max(param.opts, key=len)) + r"(?![\w-])"
            shown = rf"(?m)^  (-\w, )?{word}"
            assert re.search(shown, whole)
            left_out += [] if re.search(shown, short) else [(word, param.heading)]
    assert len(re.findall(r"(?m)^  -", short)) <= 27
    for word, heading in left_out:
        listed = re.search(rf"(?m)^  {heading} +\d+ more: (.*(\n {{4}}.*)*)", short)[1]
        topics = re.findall(r"help\s+(\w+)", listed)
        assert any(re.search(word, topic(each)) for each in topics), (word, topics)


def test_help_shows_options_under_their_headings():
    text = run("render", "--help-all").out
    places = [text.index(f"\n{heading}:") for heading in ("Lens", "Output", "Files", "Machine")]
    assert places == sorted(places)
    assert text.index("--focal-length") < text.index("\nOutput:") < text.index("--overwrite")
    assert "Examples:" in text


def test_shells_complete_commands():
    environment = {**os.environ, "_DEFOCUS_COMPLETE": "bash_source"}
    done = subprocess.run(
        [sys.executable, "-m", "defocus_cli"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "_DEFOCUS_COMPLETE=bash_complete" in done.stdout
