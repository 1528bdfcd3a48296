"""A device that is not the CPU, pretended: launches and waits of a GPU are counted without one.

Its tensors say that they are on another device and hold their values on the CPU. Who mixes both,
or takes for granted that tensors are on the CPU, fails as on a GPU. What only a GPU does (its
rounding, its memory, its threads) is not pretended: whoever renders there takes one thread.
"""

from contextlib import contextmanager

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

# A device that is there without hardware; what is really on it has no values, which is noticed.
NAME = "meta"
_INDEXED = {"aten::index", "aten::index_put", "aten::index_put_"}
# What may take a tensor from one device to another.
_MOVING = {"aten::copy_", "aten::_to_copy"}


class PretendedTensor(Tensor):
    """A tensor on the pretended device."""

    @staticmethod
    def __new__(cls, held):
        """A tensor that holds values on the CPU."""
        made = Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=torch.device(NAME),
        )
        made.held = held
        return made

    def __repr__(self, **_):
        """What it holds."""
        return f"PretendedTensor({self.held})"

    def tolist(self):
        """Its numbers, for which the host waits."""
        return self.cpu().tolist()

    def numpy(self, **_):
        """Refused, as by a device."""
        raise TypeError("what is on a device is no array of numpy")

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        """Run an operation."""
        return _run(func, args, kwargs or {})


def there(values):
    """The same on the pretended device."""
    return PretendedTensor(values)


def here(values):
    """The values of a tensor that must be on the pretended device."""
    assert isinstance(values, PretendedTensor)
    return values.held


def _run(func, args, kwargs):
    """An operation on the device on which its tensors are, or that it names."""
    name = func._schema.name
    tensors = [*_tensors(args), *_tensors(kwargs.values())]
    away = [x for x in tensors if isinstance(x, PretendedTensor)]
    others = [x for x in tensors if not isinstance(x, PretendedTensor)]
    assert all(x.device.type == "cpu" for x in others), f"{name}: made beside the pretended device"
    device = kwargs.get("device")
    named = None if device is None else torch.device(device).type
    if not away and named != NAME:
        return func(*args, **kwargs)
    index = [x for x in args[1] if x is not None] if away and name in _INDEXED else []
    if not isinstance(args[0] if args else None, Tensor) or isinstance(args[0], PretendedTensor):
        others = [x for x in others if not any(x is i for i in index)]  # indices may be here
    if name not in _MOVING:
        assert not any(x.dim() for x in others if away), f"{name}: tensors on two devices"
    if device is not None:
        kwargs = {**kwargs, "device": "cpu"}
    kwargs = {key: _changed(value, _held) for key, value in kwargs.items()}
    result = func(*_changed(args, _held), **kwargs)
    leaves = (name == "aten::_to_copy" and named == "cpu") or (
        name == "aten::copy_" and not isinstance(args[0], PretendedTensor)
    )
    if leaves or name == "aten::_local_scalar_dense":
        return result
    changed = {id(x.held): x for x in away} if func._schema.is_mutable else {}

    def moved(x):
        if id(x) in changed:
            return changed[id(x)]
        return PretendedTensor(x.resolve_conj().resolve_neg())

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
    return x.held if isinstance(x, PretendedTensor) else x


class _Made(TorchDispatchMode):
    """What is made on the pretended device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class _Given(TorchFunctionMode):
    """What is made on the pretended device of numbers of Python's."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        given = dict(kwargs or {})
        if func is torch.as_tensor and isinstance(args[0], Tensor):
            return args[0].to(**given)
        if func in (torch.tensor, torch.as_tensor):
            device = given.pop("device", None)
            made = func(*args, **given)
            return made if device is None else made.to(device)
        if func is Tensor.new_tensor and isinstance(args[0], PretendedTensor):
            return PretendedTensor(args[0].held.new_tensor(*args[1:], **given))
        if func in (Tensor.__getitem__, Tensor.__setitem__):
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            index = tuple(torch.tensor(i) if isinstance(i, list) else i for i in index)
            args = (args[0], index if isinstance(args[1], tuple) else index[0], *args[2:])
        return func(*args, **given)


@contextmanager
def pretended():
    """Where the pretended device is known."""
    with _Made(), _Given():
        yield
