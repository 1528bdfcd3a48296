"""What a rendering asks of a device: launches, waits and bytes, counted on any device.

A GPU takes some µs to begin an operation, and a host that reads a value waits until all before it
is done. Views are free. On a CPU the numbers are those of its own plan, of smaller pieces.
"""

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

# Operations whose result decides the size of a tensor, or is a number of the host.
_WAITED = {
    *("_local_scalar_dense", "nonzero", "masked_select", "equal", "bincount", "is_nonzero"),
    *("_unique", "_unique2", "unique_dim", "unique_consecutive"),
}
_INDEXED = {"index", "index_put", "index_put_", "_index_put_impl_"}
# Operations that compute nothing, though they are no views.
_FREE = {
    *("empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided"),
    *("_unsafe_view", "lift_fresh", "_local_scalar_dense", "resolve_conj", "resolve_neg"),
}


class Launches(TorchDispatchMode):
    """Counts what the thread that enters it asks of a device.

    Attributes:
        launches: Number of operations that compute or copy.
        waits: How often the host waits for a value or for the size of a result.
        written: Bytes of the results.
    """

    def __init__(self, device):
        """Count from 0."""
        super().__init__()
        self._kind = torch.device(device).type
        self.launches = self.waits = self.written = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        """Run an operation, and count it if it is one of the device."""
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        name = func.overloadpacket.__name__
        inputs, outputs = self._tensors((args, kwargs)), self._tensors(result)
        if inputs and (self._is_waited(name, args) or self._is_copied_away(name, result, args)):
            self.waits += 1
        elif not inputs and outputs and name == "_to_copy" and not kwargs.get("non_blocking"):
            self.waits += 1  # a copy from the host
        if (inputs or outputs) and not func.is_view and name not in _FREE:
            self.launches += 1
            self.written += sum(x.numel() * x.element_size() for x in outputs)
        return result

    def _tensors(self, values):
        """The tensors of the device among some values."""
        tensors = (x for x in tree_leaves(values) if isinstance(x, Tensor))
        return [x for x in tensors if x.device.type == self._kind]

    @staticmethod
    def _is_waited(name, args):
        by_mask = name in _INDEXED and any(
            x.dtype == torch.bool for x in tree_leaves(args[1]) if isinstance(x, Tensor)
        )
        return by_mask or name in _WAITED

    def _is_copied_away(self, name, result, args):
        into = args[0] if name == "copy_" else result
        if name not in ("copy_", "_to_copy") or not isinstance(into, Tensor):
            return False
        return into.device.type != self._kind
