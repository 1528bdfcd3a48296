"""Arrays that go to a device and come back; what only a GPU does is noted, for there is none."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elsewhere import NAME, elsewhere, here, there
from torch import Tensor

from defocus_core.io.arrays import computed, stacked, times
from defocus_core.picture.scene import layer_windows, map_windows, to_array, to_device, windows
from defocus_core.tensors.derived import chosen, plus

VALUES = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_arrays_come_back_as_they_were():
    assert np.array_equal(to_array(to_device(VALUES, torch.device("cpu"))), VALUES)
    with elsewhere():
        gone = to_device(VALUES, torch.device(NAME))
        assert np.array_equal(here(gone), VALUES)
        assert np.array_equal(to_array(there(torch.from_numpy(VALUES))), VALUES)


def test_windows_are_read_onto_the_device():
    with elsewhere():
        seen = windows([VALUES, 2 * VALUES], NAME)[..., 1:, 2:]
    assert np.array_equal(here(seen), np.stack([VALUES, 2 * VALUES])[:, 1:, 2:])


CUTS = (
    (..., slice(1, 3), slice(0, 2)),
    (slice(1, 2), slice(None)),
    slice(0, 2),
)


@pytest.mark.parametrize("cut", CUTS, ids=str)
def test_windows_of_what_is_computed_are_those_of_the_whole(cut):
    planes = [VALUES, VALUES**2, -VALUES]
    image = windows(planes, "cpu")
    whole, inner = torch.from_numpy(np.stack(planes)), cut if isinstance(cut, tuple) else (cut,)
    inner = (..., *(each for each in inner if each is not ...), *[slice(None)] * (len(inner) < 2))
    pairs = {
        "some": (chosen(image, [2, 0]), whole[[2, 0]]),
        "farther": (plus(image, 2.5), whole + 2.5),
        "layers": (layer_windows([map_windows(p, "cpu") for p in planes]), whole),
    }
    for name, (lazy, held) in pairs.items():
        assert tuple(lazy.shape) == tuple(held.shape), name
        assert torch.equal(lazy[cut], held[inner]), name
    rows = inner[1]
    assert np.array_equal(stacked(planes)[rows], np.stack(planes, 2)[rows])
    assert np.array_equal(times(VALUES, 2, 1)[cut], (2 * VALUES + 1)[cut])
    assert np.array_equal(computed(np.maximum, *planes[1:])[cut], np.maximum(*planes[1:])[cut])


@contextmanager
def gpu(patch):
    """What is asked of a GPU, which takes and gives tensors as they are."""
    asked: list[str] = []
    empty = torch.empty

    def pinned(values):
        asked.append("pinned")
        return values.clone()

    def moved(values, device, *, non_blocking=False):
        asked.append(f"to {device.type}, {'without' if non_blocking else 'with'} waiting")
        return values.clone()

    def made(*size, pin_memory=False, **options):
        asked.append("pinned" if pin_memory else "made")
        return empty(*size, **options)  # type: ignore[call-overload, no-any-return]

    stream = SimpleNamespace(synchronize=lambda: asked.append("waited for"))
    with patch.context() as patched:
        patched.setattr(Tensor, "pin_memory", pinned)
        patched.setattr(Tensor, "to", moved)
        patched.setattr(Tensor, "is_cuda", True)
        patched.setattr(torch, "empty", made)
        patched.setattr(torch.cuda, "current_stream", lambda device: stream)
        yield asked


def test_copies_to_a_gpu_are_pinned(monkeypatch):
    with gpu(monkeypatch) as asked:
        gone = to_device(VALUES, torch.device("cuda"))
        assert asked == ["pinned", "to cuda, without waiting"]
        back = to_array(gone)
    assert asked[2:] == ["pinned", "waited for"]
    assert np.array_equal(back, VALUES)
