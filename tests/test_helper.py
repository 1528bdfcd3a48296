"""A second process does a part of the work, and nothing depends on whether it does."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from itertools import islice

import pytest
import torch

from defocus_cli import sharing
from defocus_cli.helper import Helper, can_help, helped, is_helped
from defocus_core.threads import threaded

pytestmark = pytest.mark.skipif(not can_help(), reason="this system does not copy processes")
HERE = os.getpid()
Piece = Callable[[int], tuple[int, int]]


def slow(piece: int) -> tuple[int, int]:
    time.sleep(0.005)
    return piece, os.getpid()


def all_of(
    work: Piece, count: int = 20, *, threads: int = 2, last: bool = False
) -> tuple[list[tuple[int, int]], Helper]:
    """Results of a call that two processes share."""

    def calls() -> Iterator[tuple[int, int]]:
        return threaded(work, range(count), threads, last=last)

    with helped(calls) as helper:
        found = list(calls())
    return found, helper


def numbers(found: list[tuple[int, int]]) -> list[int]:
    return [number for number, _ in found]


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("threads", [2, 3, 5])
def test_both_do_a_part_and_results_come_in_order(threads: int, last: bool) -> None:
    found, helper = all_of(slow, 40, threads=threads, last=last)
    assert numbers(found) == list(range(40))
    assert len({process for _, process in found}) == 2
    assert helper.lost == ""


def test_of_many_calls_each_gets_its_own() -> None:
    def total() -> list[int]:
        return [sum(numbers(list(threaded(slow, range(n), 2, last=n == 9)))) for n in range(2, 10)]

    with helped(total):
        found = total()
    assert found == [n * (n - 1) // 2 for n in range(2, 10)]


def test_a_call_within_what_is_taken_from_another_is_shared_too() -> None:
    """As cells are enlarged while others are rendered."""

    def nested() -> list[list[tuple[int, int]]]:
        return [list(threaded(slow, range(n + 2), 2)) for n, _ in threaded(slow, range(6), 2)]

    with helped(nested):
        found = nested()
    assert [numbers(each) for each in found] == [list(range(n + 2)) for n in range(6)]
    assert len({process for each in found for _, process in each}) == 2


def test_what_a_piece_shares_out_stays_in_its_process() -> None:
    def piece(number: int) -> tuple[int, int]:
        assert {process for _, process in threaded(slow, range(3), 2)} == {os.getpid()}
        return slow(number)

    found, helper = all_of(piece)
    assert numbers(found) == list(range(20))
    assert helper.lost == ""


def test_modes_are_those_of_the_caller() -> None:
    def piece(number: int) -> tuple[int, int]:
        assert not torch.is_grad_enabled()
        return slow(number)

    with torch.no_grad():
        found, helper = all_of(piece, threads=5)
    assert len(found) == 20
    assert helper.lost == ""


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "was ended by SIGKILL"),
        (lambda: os.kill(os.getpid(), signal.SIGTERM), "was ended by SIGTERM"),
        (lambda: 1 / 0, "failed"),
    ],
)
def test_who_is_lost_is_done_without(end: Callable[[], object], words: str, last: bool) -> None:
    def piece(number: int) -> tuple[int, int]:
        if os.getpid() != HERE and number > 5:
            end()
        return slow(number)

    found, helper = all_of(piece, last=last)
    assert numbers(found) == list(range(20))
    assert helper.lost == words


def test_who_does_not_answer_is_done_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "_PATIENCE", 1)

    def piece(number: int) -> tuple[int, int]:
        if os.getpid() != HERE:
            time.sleep(100)
        return slow(number)

    start = time.monotonic()
    found, helper = all_of(piece)
    assert numbers(found) == list(range(20))
    assert helper.lost == "did not answer"
    assert time.monotonic() - start < 50


@pytest.mark.parametrize("threads", [2, 5])
def test_an_error_in_a_piece_is_raised(threads: int) -> None:
    def piece(number: int) -> tuple[int, int]:
        if number == 7:
            raise ValueError("seven")
        return slow(number)

    with pytest.raises(ValueError, match="seven"):
        all_of(piece, threads=threads)


@pytest.mark.parametrize("threads", [2, 5])
def test_no_piece_is_begun_for_who_takes_no_more(threads: int) -> None:
    def some() -> list[tuple[int, int]]:
        return list(islice(threaded(slow, range(100_000), threads), 3))

    with helped(some):
        assert numbers(some()) == [0, 1, 2]


def test_a_block_leaves_no_process() -> None:
    known = set(children())
    for error in (None, KeyboardInterrupt):
        try:
            with helped(lambda: [time.sleep(100)]):
                assert len(set(children()) - known) == 1
                if error:
                    raise error
        except KeyboardInterrupt:
            pass
        assert set(children()) == known


def children() -> list[str]:
    with open(f"/proc/self/task/{os.getpid()}/children") as file:  # noqa: PTH123
        return file.read().split()


def test_what_it_used_is_told() -> None:
    def piece(number: int) -> tuple[int, int]:
        held = torch.ones(10_000_000)  # 40 MB
        return int(held.sum() > 0) * number, os.getpid()

    _, helper = all_of(piece)
    assert helper.cpu_seconds > 0
    assert 30 < helper.grown_mb < 200


def test_only_what_is_large_is_helped_and_only_on_a_cpu_with_threads() -> None:
    assert is_helped(2, "cpu", (2160, 3840))
    assert not is_helped(1, "cpu", (2160, 3840))
    assert not is_helped(2, "cuda", (2160, 3840))
    assert not is_helped(2, "cpu", (1080, 1920))
    assert is_helped(3, "cpu", (1080, 1920))
    assert not is_helped(3, "cpu", (720, 1280))
