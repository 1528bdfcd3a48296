"""Arrays that go to a device and come back; what only a GPU does is noted, for there is none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elsewhere import NAME, elsewhere, here, there
from torch import Tensor

from defocus_core.batch.sources import to_array, to_device, windows

VALUES = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_arrays_come_back_as_they_were() -> None:
    assert np.array_equal(to_array(to_device(VALUES, torch.device("cpu"))), VALUES)
    with elsewhere():
        gone = to_device(VALUES, torch.device(NAME))
        assert np.array_equal(here(gone), VALUES)
        assert np.array_equal(to_array(there(torch.from_numpy(VALUES))), VALUES)


def test_windows_are_read_onto_the_device() -> None:
    with elsewhere():
        seen = windows([VALUES, 2 * VALUES], NAME)[..., 1:, 2:]
    assert np.array_equal(here(seen), np.stack([VALUES, 2 * VALUES])[:, 1:, 2:])


@contextmanager
def gpu(patch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What is asked of a GPU, which takes and gives tensors as they are."""
    asked: list[str] = []
    empty = torch.empty

    def pinned(values: Tensor) -> Tensor:
        asked.append("pinned")
        return values.clone()

    def moved(values: Tensor, device: torch.device, *, non_blocking: bool = False) -> Tensor:
        asked.append(f"to {device.type}, {'without' if non_blocking else 'with'} waiting")
        return values.clone()

    def made(*size: object, pin_memory: bool = False, **options: object) -> Tensor:
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


def test_copies_to_a_gpu_are_pinned(monkeypatch: pytest.MonkeyPatch) -> None:
    with gpu(monkeypatch) as asked:
        gone = to_device(VALUES, torch.device("cuda"))
        assert asked == ["pinned", "to cuda, without waiting"]
        back = to_array(gone)
    assert asked[2:] == ["pinned", "waited for"]
    assert np.array_equal(back, VALUES)
