"""A device that is not the CPU, pretended: what breaks there is found where there is no GPU.

Its tensors say that they are on another device and hold their values on the CPU. Who mixes both,
or takes for granted that tensors are on the CPU, fails as on a GPU; who waits for a value is noted.
What only a GPU does (its rounding, its memory) is not pretended.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import NamedTuple

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from defocus_core.tensors import torch_modes

# A device that is there without hardware; what is really on it has no values, which is noticed.
NAME = "meta"

# Operations whose result the host must have before it goes on.
_WAITED = {
    "aten::_local_scalar_dense",
    "aten::nonzero",
    "aten::masked_select",
    "aten::_unique2",
    "aten::unique_consecutive",
    "aten::equal",
    "aten::bincount",
}
_INDEXED = {"aten::index", "aten::index_put", "aten::index_put_"}
# What may take a tensor from one device to another.
_MOVING = {"aten::copy_", "aten::_to_copy"}

# Operations waited for, by name.
waits: Counter[str] = Counter()


class Elsewhere(Tensor):
    """A tensor on the other device."""

    held: Tensor

    @staticmethod
    def __new__(cls, held):
        made: Elsewhere = Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=NAME,
        )
        made.held = held
        return made

    def __repr__(self, **_):
        return f"Elsewhere({self.held})"

    def tolist(self):
        return self.cpu().tolist()

    def numpy(self, **_):
        raise TypeError("what is on a device is no array of numpy")

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


def there(values):
    """The same on the other device."""
    return Elsewhere(values)


def here(values):
    """The values of a tensor that must be on the other device."""
    assert isinstance(values, Elsewhere)
    return values.held


def _run(func, args, kwargs):
    """An operation on the device on which its tensors are, or that it names."""
    name = func._schema.name
    tensors = [*_tensors(args), *_tensors(kwargs.values())]
    away = [x for x in tensors if isinstance(x, Elsewhere)]
    others = [x for x in tensors if not isinstance(x, Elsewhere)]
    assert all(x.device.type == "cpu" for x in others), f"{name}: made beside the pretended device"
    device = kwargs.get("device")
    named = None if device is None else torch.device(device).type
    if not away and named != torch.device(NAME).type:
        return func(*args, **kwargs)
    index = [x for x in args[1] if x is not None] if away and name in _INDEXED else []
    if not isinstance(args[0] if args else None, Tensor) or isinstance(args[0], Elsewhere):
        others = [x for x in others if not any(x is i for i in index)]  # indices may be here
    if name not in _MOVING:
        assert not any(x.dim() for x in others if away), f"{name}: tensors on two devices"
    leaves = (name == "aten::_to_copy" and named == "cpu") or (
        name == "aten::copy_" and not isinstance(args[0], Elsewhere)
    )
    arrives = not away and name == "aten::_to_copy" and not kwargs.get("non_blocking")
    if leaves or arrives or (away and name in _WAITED) or any(i.dtype == torch.bool for i in index):
        waits[name] += 1
    if device is not None:
        kwargs = {**kwargs, "device": "cpu"}
    kwargs = {key: _changed(value, _held) for key, value in kwargs.items()}
    result = func(*_changed(args, _held), **kwargs)
    if leaves or name == "aten::_local_scalar_dense":
        return result
    changed = {id(x.held): x for x in away} if func._schema.is_mutable else {}

    def moved(x):
        return changed[id(x)] if id(x) in changed else Elsewhere(x.resolve_conj().resolve_neg())

    return _changed(result, moved)


def _tensors(values):
    """The tensors among arguments, and in lists of them."""
    for value in values:
        if isinstance(value, Tensor):
            yield value
        elif isinstance(value, list | tuple):
            yield from _tensors(value)


def _changed(value, change):
    """A tensor, or those in lists, changed; other arguments as they are."""
    if isinstance(value, Tensor):
        return change(value)
    if isinstance(value, list | tuple):
        return type(value)(_changed(one, change) for one in value)
    return value


def _held(x):
    return x.held if isinstance(x, Elsewhere) else x


class _Made(TorchDispatchMode):
    """What is made on the other device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class _Given(TorchFunctionMode):
    """What is made on the other device of numbers of Python's."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if func is torch.as_tensor and isinstance(args[0], Tensor):
            return args[0].to(**kwargs)
        if func in (torch.tensor, torch.as_tensor):
            device = kwargs.pop("device", None)
            made = func(*args, **kwargs)
            return made if device is None else made.to(device)
        if func is Tensor.new_tensor and isinstance(args[0], Elsewhere):
            return Elsewhere(args[0].held.new_tensor(*args[1:], **kwargs))
        if func in (Tensor.__getitem__, Tensor.__setitem__):
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            index = tuple(torch.tensor(i) if isinstance(i, list) else i for i in index)
            args = (args[0], index if isinstance(args[1], tuple) else index[0], *args[2:])
        return func(*args, **kwargs)


@contextmanager
def elsewhere():
    """Where the other device is known."""
    waits.clear()
    with _known(), pytest.MonkeyPatch.context() as patch:
        # views of what was made in another mode have no version, of subclasses
        patch.setattr(torch, "inference_mode", lambda mode=True: nullcontext())
        checkpoint = torch_modes.checkpoint

        def again(work, *args, **options):
            def worked(*pieces):
                with _known():  # modes are those of whom the backward pass belongs to
                    return work(*pieces)

            return checkpoint(worked, *args, **options)

        patch.setattr(torch_modes, "checkpoint", again)
        yield


@contextmanager
def _known():
    with _Made(), _Given():
        yield


class Device(NamedTuple):
    """A device that is not the CPU, pretended or real.

    Attributes:
        name: As torch has it.
        there: Takes a tensor to it.
        here: Takes a tensor of it to the CPU.
        known: Where it is known.
        within: Greatest difference from the pictures of the CPU: of other sizes of transforms, and
            on a real one of its own rounding.
    """

    name: str
    there: Callable[[Tensor], Tensor]
    here: Callable[[Tensor], Tensor]
    known: Callable[[], AbstractContextManager[None]]
    within: float


PRETENDED = Device(NAME, there, here, elsewhere, 2e-6)
CPU = Device("cpu", lambda x: x, lambda x: x, nullcontext, 1e-6)
CUDA = Device("cuda", lambda x: x.to("cuda"), lambda x: x.cpu(), nullcontext, 1e-4)
DEVICES = [
    pytest.param(PRETENDED, id="pretended"),
    pytest.param(
        CUDA,
        id="cuda",
        marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"),
    ),
]
