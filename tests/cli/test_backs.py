"""Which back made a picture is known: compiled loops, or torch."""

from importlib.metadata import version

import numpy as np
import pytest
import torch
from batches import JOBS, jobs_file, records
from command_line import header, pair, photograph, run, succeed
from renderers import HAS_LOOPS, NEEDS_LOOPS

TOOK = "compiled" if HAS_LOOPS else "torch"


def without_numba(monkeypatch):
    monkeypatch.setattr("defocus_core.renderer.compiled.carried.available", lambda: False)


def test_the_record_the_header_and_the_card_name_what_computed(tmp_path, out):
    succeed("batch", jobs_file(tmp_path, text=JOBS), "-o", out, "--processes", "1")
    told = records(out)[0]["software"]
    assert told.startswith(f"torch {torch.__version__}, numpy {np.__version__}")
    assert ", CPU " in told
    assert header(next(out.glob("coc/*.exr")))["defocus:software"] == told
    assert f"Made by defocus {version('defocus')}, renderer" in (out / "README.md").read_text()
    assert told in (out / "README.md").read_text()


def test_the_record_the_header_and_words_name_the_back(tmp_path, monkeypatch):
    files = pair(tmp_path)
    for name, back in (("one", TOOK), ("two", "torch")):
        out = tmp_path / name
        assert f"cpu ({back})" in photograph(*files, "-o", out, "-v").err
        assert header(out / "render" / "a.exr")["defocus:back"] == back
        assert records(out)[0]["back"] == back
        without_numba(monkeypatch)


@pytest.mark.parametrize("words", [("--quality", "high"), ("--spherical", "0.3"), ("--tile", "64")])
def test_what_the_compiled_loops_do_not_carry_is_rendered_by_torch(words, tmp_path):
    photograph(*pair(tmp_path), "-o", tmp_path / "out", *words)
    assert records(tmp_path / "out")[0]["back"] == "torch"


def test_version_says_what_renders_on_a_cpu(monkeypatch):
    if TOOK == "compiled":
        assert "on a CPU compiled by Numba" in run("--version").out
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert "on a CPU by torch, as NUMBA_DISABLE_JIT is set" in run("--version").out


@pytest.mark.skipif(**NEEDS_LOOPS)
def test_a_run_that_goes_on_with_another_back_says_so_and_compare_does(tmp_path, out, monkeypatch):
    path = jobs_file(tmp_path, "a", "b", text=JOBS.replace('"coc"', '"render"'))
    batch = ("batch", path, "--processes", "1", "-o")
    succeed(*batch, tmp_path / "other")
    assert "earlier pictures" not in succeed(*batch, out, "--limit", "1").err
    without_numba(monkeypatch)
    told = succeed(*batch, out).err
    assert "earlier pictures are by compiled, those of this run by torch" in told
    assert "earlier pictures" not in succeed(*batch, out).err
    told = run("compare", tmp_path / "other", out).out
    assert "recipe: back torch instead of compiled in 3 of 4 samples" in told
