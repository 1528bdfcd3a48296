"""Runs the command line inside the test process, and makes small inputs for it."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from defocus_cli.main import main

LENS = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "2m")
WIDTH, HEIGHT = 24, 16
PITCH = 36.0 / WIDTH  # mm


@dataclass(frozen=True)
class Ran:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


class Terminal(io.StringIO):
    """A stream that a person watches."""

    def isatty(self) -> bool:
        return True


def run(*args: str | Path, err: io.StringIO | None = None) -> Ran:
    out, err = io.StringIO(), err or io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([str(arg) for arg in args])
    return Ran(code, out.getvalue(), err.getvalue())


def render(*args: str | Path) -> Ran:
    return run("render", *LENS, *args)


def refused(ran: Ran, code: int, *words: str) -> None:
    """Assert that the run ended with ``code`` and one line on stderr that holds all ``words``."""
    assert ran.code == code, ran.err
    assert ran.out == ""
    assert ran.err.startswith("defocus: ")
    assert ran.err.count("\n") == 1
    assert "Traceback" not in ran.err
    for word in words:
        assert word in ran.err


def refused_input(ran: Ran, file: Path, *words: str) -> None:
    """Refused because of ``file``, with a remedy, and nothing written beside the inputs."""
    refused(ran, 3, *words)
    assert ran.err.startswith(f"defocus: {file}: ")
    assert "; " in ran.err
    assert not (file.parent / "out").exists()


def write_exr(path: Path, **channels: np.ndarray[Any, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    named = {name.replace("_", "."): np.ascontiguousarray(v) for name, v in channels.items()}
    OpenEXR.File(header, named).write(str(path))
    return path


def read_exr(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels) for name, channel in channels.items()}


def header(path: Path) -> dict[str, Any]:
    return dict(OpenEXR.File(str(path), separate_channels=True).header())


def texture(width: int = WIDTH, height: int = HEIGHT, seed: int = 0) -> np.ndarray[Any, Any]:
    """A colour image, float32 [H, W, 3] in 0…1."""
    return np.random.default_rng(seed).random((height, width, 3), np.float32)


def ramp(width: int = WIDTH, height: int = HEIGHT) -> np.ndarray[Any, Any]:
    """Depth in metres from 1 at the left to 4 at the right, float32 [H, W]."""
    return np.tile(np.linspace(1, 4, width, dtype=np.float32), (height, 1))


def color_exr(path: Path, pixels: np.ndarray[Any, Any] | None = None) -> Path:
    pixels = texture() if pixels is None else pixels
    return write_exr(path, R=pixels[..., 0], G=pixels[..., 1], B=pixels[..., 2])


def depth_exr(path: Path, metres: np.ndarray[Any, Any] | None = None) -> Path:
    return write_exr(path, Z=ramp() if metres is None else metres)


def pair(folder: Path, stem: str = "a") -> tuple[Path, Path]:
    """A colour and a depth file of one picture."""
    return color_exr(folder / "rgb" / f"{stem}.exr"), depth_exr(folder / "depth" / f"{stem}.exr")


def files_under(folder: Path) -> set[str]:
    """All files but the journal."""
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    return found - {"journal.jsonl"}


def thin_lens_radius(z_mm: np.ndarray[Any, Any], *, s: float = 2000.0) -> np.ndarray[Any, Any]:
    """f²/(N (s − f)) (z − s)/z / (2 p) for the lens of `command_line.LENS`."""
    f, N = 50.0, 2.0
    return np.asarray(f * f / (N * (s - f)) * (z_mm - s) / z_mm / (2 * PITCH))
