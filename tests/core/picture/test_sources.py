"""Arrays that go to a device and come back; what only a GPU does is noted, for there is none."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import torch
from elsewhere import NAME, elsewhere, here, there
from torch import Tensor

from defocus_core.picture.scene import map_on, picture_on, to_array

VALUES = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_arrays_come_back_as_they_were():
    assert np.array_equal(to_array(map_on(VALUES, "cpu")), VALUES)
    with elsewhere():
        gone = map_on(VALUES, NAME)
        assert np.array_equal(here(gone), VALUES)
        assert np.array_equal(to_array(there(torch.from_numpy(VALUES))), VALUES)


def test_a_picture_is_taken_onto_the_device():
    with elsewhere():
        seen = picture_on([VALUES, 2 * VALUES], NAME)
    assert np.array_equal(here(seen), np.stack([VALUES, 2 * VALUES]))


@contextmanager
def gpu(patch):
    """What is asked of a GPU, which takes and gives tensors as they are."""
    asked: list[str] = []
    empty = torch.empty

    def made(*size, pin_memory=False, **options):
        asked.append("pinned" if pin_memory else "made")
        return empty(*size, **options)  # type: ignore[call-overload, no-any-return]

    stream = SimpleNamespace(synchronize=lambda: asked.append("waited for"))
    with patch.context() as patched:
        patched.setattr(Tensor, "is_cuda", True)
        patched.setattr(torch, "empty", made)
        patched.setattr(torch.cuda, "current_stream", lambda device: stream)
        yield asked


def test_copies_from_a_gpu_are_pinned(monkeypatch):
    with gpu(monkeypatch) as asked:
        back = to_array(torch.from_numpy(VALUES))
    assert asked == ["pinned", "waited for"]
    assert np.array_equal(back, VALUES)
