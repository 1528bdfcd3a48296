"""Runs the command line inside the test process, and makes small inputs for it."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import OpenEXR
from click import ClickException

from defocus_cli import main as entry
from defocus_cli.options.shared import option_name
from defocus_core import DefocusError

LENS = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "2m")
WIDTH, HEIGHT = 24, 16
PITCH = 36.0 / WIDTH  # mm


@dataclass(frozen=True)
class Ran:
    """What a command left behind; ``error`` is what ended it."""

    code: int
    out: str
    err: str
    error: DefocusError | ClickException | None = None

    @property
    def json(self):
        return json.loads(self.out)


class Terminal(io.StringIO):
    """A stream that a person watches."""

    def isatty(self):
        return True


def run(*args, err=None):
    out, err = io.StringIO(), err or io.StringIO()
    ended: list[Any] = []

    def noting(say):
        return lambda error: (ended.append(error), say(error))[1]

    with (
        redirect_stdout(out),
        redirect_stderr(err),
        patch.object(entry, "exit_code_of", noting(entry.exit_code_of)),
        patch.object(entry, "error_line", noting(entry.error_line)),
    ):
        code = entry.main([str(arg) for arg in args])
    return Ran(code, out.getvalue(), err.getvalue(), *ended)


def topic(name):
    """A topic of the help, as it is printed."""
    return run("help", name).out


def render(*args):
    return run("render", *LENS, *args)


def succeed(*args):
    """Run a command that ends well."""
    ran = run(*args)
    assert ran.code == 0, ran.err
    return ran


def photograph(*args):
    """Render by the lens of most tests, which ends well."""
    return succeed("render", *LENS, *args)


def failed(ran, exit_code, code, *at):
    """Assert that the run ended with this error, whatever was done and said before.

    Args:
        ran: the run.
        exit_code: its exit code.
        code: of the error; None of a command line that click refuses, which has none.
        at: what the error is about: its file, as a path or by its name, and its option or key.
    """
    assert ran.code == exit_code, ran.err
    assert "Traceback" not in ran.err
    if isinstance(ran.error, DefocusError):
        path, field = ran.error.path or "", ran.error.field
    else:
        param = getattr(ran.error, "param", None)
        option = option_name(param) if param else getattr(ran.error, "option_name", "")
        path, field = "", option.removeprefix("--")
    assert getattr(ran.error, "code", None) == code, ran.err
    for each in at:
        subjects = (path,) if isinstance(each, Path) else (path, field, Path(path).name)
        assert str(each) in subjects, ran.err


def refused(ran, exit_code, code, *at):
    """Assert that the run did nothing but say this error in one line."""
    failed(ran, exit_code, code, *at)
    assert ran.out == ""
    assert ran.err.startswith("defocus: ")
    assert ran.err.count("\n") == 1


def refused_input(ran, file, *codes):
    """Refused because of ``file``, for one of ``codes``, with nothing written beside the inputs."""
    assert isinstance(ran.error, DefocusError)
    assert ran.error.code in codes, ran.err
    assert ran.error.remedy
    refused(ran, 3, ran.error.code, file)
    assert not (file.parent / "out").exists()


def write_exr(path, **channels):
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    named = {name.replace("_", "."): np.ascontiguousarray(v) for name, v in channels.items()}
    OpenEXR.File(header, named).write(str(path))
    return path


def read_exr(path):
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels) for name, channel in channels.items()}


def header(path):
    return dict(OpenEXR.File(str(path), separate_channels=True).header())


def texture(width=WIDTH, height=HEIGHT, seed=0):
    """A colour image, float32 [H, W, 3] in 0…1."""
    return np.random.default_rng(seed).random((height, width, 3), np.float32)


def ramp(width=WIDTH, height=HEIGHT):
    """Depth in metres from 1 at the left to 4 at the right, float32 [H, W]."""
    return np.tile(np.linspace(1, 4, width, dtype=np.float32), (height, 1))


def color_exr(path, pixels=None):
    pixels = texture() if pixels is None else pixels
    return write_exr(path, R=pixels[..., 0], G=pixels[..., 1], B=pixels[..., 2])


def depth_exr(path, metres=None):
    return write_exr(path, Z=ramp() if metres is None else metres)


def pair(folder, stem="a"):
    """A colour and a depth file of one picture."""
    return color_exr(folder / "rgb" / f"{stem}.exr"), depth_exr(folder / "depth" / f"{stem}.exr")


def files_under(folder):
    """All files but the journal and its copy."""
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    return found - {"journal.jsonl"}


def hidden_in(folder):
    """The names of all hidden files."""
    return {path.name for path in folder.rglob(".*")}


def thin_lens_radius(z_mm, *, s=2000.0):
    """f²/(N (s − f)) (z − s)/z / (2 p) for the lens of `command_line.LENS`."""
    f, N = 50.0, 2.0
    return np.asarray(f * f / (N * (s - f)) * (z_mm - s) / z_mm / (2 * PITCH))
