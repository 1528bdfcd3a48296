"""Results of work, sent to another process: what is large lies in memory that both see."""

from __future__ import annotations

import io
import mmap
import os
import pickle
import socket
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from torch import Tensor

# Bytes up to which a parcel is sent as it is: less than systems let a message have.
_SMALL = 1 << 14
_HEADER = struct.Struct("<iiqq")
_ALIGNED = 64  # as tensors of torch are


class Parcel(NamedTuple):
    """A result of work.

    Attributes:
        call: the number of the call that shared the work out.
        piece: that of the piece.
        result: what came of it.
    """

    call: int
    piece: int
    result: Any


class _Packer(pickle.Pickler):
    """Sets tensors aside: of each it writes the offset, the shape and the type."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.tensors: list[tuple[int, Tensor]] = []
        self.end = 0

    def persistent_id(self, found: object) -> object:
        import torch

        if not isinstance(found, torch.Tensor):
            return None
        at, size = self.end, found.numel() * found.element_size()
        self.tensors.append((at, found))
        self.end += -(-size // _ALIGNED) * _ALIGNED
        return at, tuple(found.shape), found.dtype


class _Unpacker(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, held: Tensor) -> None:
        super().__init__(file)
        self.held = held

    def persistent_load(self, told: Any) -> Tensor:
        at, shape, dtype = told
        return _tensor(self.held, at, shape, dtype)


def _tensor(held: Tensor, at: int, shape: tuple[int, ...], dtype: Any) -> Tensor:
    """The tensor at a byte of a buffer."""
    import torch

    size = torch.Size(shape).numel() * dtype.itemsize
    if not size:
        return torch.empty(shape, dtype=dtype)
    return held[at : at + size].view(dtype).view(shape)


def send(channel: socket.socket, parcel: Parcel) -> None:
    """Send a parcel; its tensors are those of a CPU.

    Raises:
        OSError: nobody is there to receive it.
    """
    import torch

    packer = _Packer(file := io.BytesIO())
    packer.dump(parcel.result)
    told = file.getvalue()
    size = packer.end + len(told)
    header = _HEADER.pack(parcel.call, parcel.piece, packer.end, size)
    descriptor = -1 if size <= _SMALL else os.memfd_create("defocus")
    try:
        memory: bytearray | mmap.mmap = bytearray(size)
        if descriptor >= 0:
            os.ftruncate(descriptor, size)
            memory = mmap.mmap(descriptor, size)
        held = torch.frombuffer(memory, dtype=torch.uint8)
        for at, tensor in packer.tensors:
            _tensor(held, at, tuple(tensor.shape), tensor.dtype).copy_(tensor)
        held[packer.end :] = torch.frombuffer(bytearray(told), dtype=torch.uint8)
        if descriptor >= 0:
            socket.send_fds(channel, [header], [descriptor])
        else:
            channel.sendall(header + memory)
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def receive(channel: socket.socket) -> Parcel | None:
    """The next parcel; None when nobody is there any more to send one.

    Raises:
        OSError: the channel is closed.
    """
    import torch

    message, descriptors, _, _ = socket.recv_fds(channel, _HEADER.size + _SMALL, 1)
    if not message:
        return None
    call, piece, end, size = _HEADER.unpack_from(message)
    memory: bytearray | mmap.mmap = bytearray(message[_HEADER.size :])
    for descriptor in descriptors:
        memory = mmap.mmap(descriptor, size)
        os.close(descriptor)
    held = torch.frombuffer(memory, dtype=torch.uint8)
    told = io.BytesIO(memory[end:size])
    return Parcel(call, piece, _Unpacker(told, held).load())
