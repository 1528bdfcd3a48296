"""Functions are compiled once for all processes, and kept until a source changes."""

import subprocess
import sys
from ast import literal_eval
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from renderers import NEEDS_LOOPS

from defocus_core.renderer.compiled import kept

pytestmark = pytest.mark.skipif(**NEEDS_LOOPS)


# Prints how many types of arguments each function that Python calls was compiled for, after what is
# compiled at once, and after pictures of all kinds.
_TYPES = """
import importlib, pkgutil
import torch
from defocus_core import render
from defocus_core.renderer import compiled
from defocus_core.renderer.compiled.once import render_everything

names = [f"{compiled.__name__}.{each.name}" for each in pkgutil.iter_modules(compiled.__path__)]
found = [f for name in names for f in vars(importlib.import_module(name)).values()]
entries = {f.__name__: f for f in found if hasattr(f, "py_func") and f.stats.cache_path}
render_everything()
print(sorted((name, len(f.signatures)) for name, f in entries.items()))
image = torch.rand(3, 90, 120, generator=torch.Generator().manual_seed(2))
radius = torch.linspace(-45, 50, 120).expand(90, 120).clone()
radius[30:60, 20:70] = -2.0
image[:, 70, 80] = 400.0
for pixels in (image, image[:1], image.clamp(0, 1)):
    render(pixels, radius, left_right=True)
    render(pixels, radius / 20)
print(sorted((name, len(f.signatures)) for name, f in entries.items()))
"""


def test_all_that_a_picture_needs_is_compiled_at_once():
    """Else the first pictures of each kind would wait, and nobody would say why."""
    ran = subprocess.run([sys.executable, "-c", _TYPES], capture_output=True, text=True, check=True)
    once, later = map(literal_eval, ran.stdout.splitlines())
    assert once == later
    assert len(once) > 8
    assert {count for _, count in once} == {1}


def test_one_process_compiles_and_others_wait(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "folder", lambda: tmp_path)

    def compiles(_):
        with kept.one_process() as is_due:
            return is_due

    with ThreadPoolExecutor(4) as pool:
        assert sorted(pool.map(compiles, range(8))) == [False] * 7 + [True]


def test_what_is_interrupted_is_compiled_again(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "folder", lambda: tmp_path)
    with pytest.raises(KeyboardInterrupt), kept.one_process():
        raise KeyboardInterrupt
    with kept.one_process() as is_due:
        assert is_due


def test_the_compiled_back_is_not_imported_without_need():
    """Numba takes half a second."""
    code = "import sys, defocus_core.renderer.engine.renderer; print('numba' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


def test_functions_are_kept_where_the_user_may_write(tmp_path, monkeypatch):
    kept.folder.cache_clear()
    beside = kept.folder()
    assert beside.parent == Path(kept.__file__).parent / "__pycache__"
    monkeypatch.setattr(kept, "__file__", "/proc/kept.py")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept.folder.cache_clear()
    assert kept.folder().parent == tmp_path / "defocus"
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc")
    kept.folder.cache_clear()
    assert kept.folder() is None
    kept.folder.cache_clear()
