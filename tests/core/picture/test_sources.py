"""Arrays that go to a device and come back; what only a GPU does is noted, for there is none."""

from types import SimpleNamespace

import numpy as np
import torch

from defocus_core.picture.scene import to_array

VALUES = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_copies_from_a_gpu_are_pinned(monkeypatch):
    asked, empty = [], torch.empty

    def made(*size, pin_memory=False, **options):
        asked.append("pinned" if pin_memory else "made")
        return empty(*size, **options)

    stream = SimpleNamespace(synchronize=lambda: asked.append("waited for"))
    with monkeypatch.context() as patched:
        patched.setattr(torch.Tensor, "is_cuda", True)
        patched.setattr(torch, "empty", made)
        patched.setattr(torch.cuda, "current_stream", lambda device: stream)
        back = to_array(torch.from_numpy(VALUES))
    assert asked == ["pinned", "waited for"]
    assert np.array_equal(back, VALUES)
