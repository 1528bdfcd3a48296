"""Arrays that go to a device and come back; what only a GPU does is noted, for there is none."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from defocus_core.picture.scene import to_array

VALUES = np.arange(12, dtype=np.float32).reshape(3, 4)


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
