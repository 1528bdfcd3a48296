"""Results of work arrive in another process as they were sent."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from defocus_cli.parcels import Parcel, receive, send
from defocus_core.tiling import Box


class Result(NamedTuple):
    box: Box
    tensors: list[Tensor]
    counts: dict[str, int]


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with here, there:
        yield here, there


@pytest.mark.parametrize("side", [3, 200])
def test_what_is_sent_arrives(ends: tuple[socket.socket, socket.socket], side: int) -> None:
    plain = torch.rand(3, side, side + 1, generator=torch.Generator().manual_seed(side))
    tensors = [
        *(plain, plain.mT, plain[:1].expand(3, -1, -1), plain[:, ::2, 1:], plain.sum()),
        *(plain.double(), plain.half(), plain > 0.5, (plain * 1e6).to(torch.int32)),
        plain.new_empty(0, 3),
    ]
    result = Result(Box(1, 2, side, side), tensors, {"tiles": side})
    send(ends[0], Parcel(7, 3, result))
    found = receive(ends[1])
    assert found is not None
    assert (found.call, found.piece) == (7, 3)
    assert (found.result.box, found.result.counts) == (result.box, result.counts)
    for told, tensor in zip(found.result.tensors, tensors, strict=True):
        assert told.dtype == tensor.dtype
        assert torch.equal(told, tensor)


def test_what_arrived_is_kept_when_more_comes(ends: tuple[socket.socket, socket.socket]) -> None:
    for piece in range(3):
        send(ends[0], Parcel(0, piece, torch.full((90, 90), float(piece))))
    found = [receive(ends[1]) for _ in range(3)]
    assert [int(parcel.result.amax()) for parcel in found if parcel] == [0, 1, 2]


def test_who_has_gone_sends_nothing_and_receives_nothing(
    ends: tuple[socket.socket, socket.socket],
) -> None:
    ends[0].close()
    assert receive(ends[1]) is None
    with pytest.raises(OSError, match=r"[Pp]ipe|[Cc]onnection"):
        send(ends[1], Parcel(0, 0, None))
