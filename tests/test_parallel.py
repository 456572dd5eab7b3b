"""Many calls: outcomes of ours are handed on, anything else ends the work."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from threading import Event

import pytest

from tossid.errors import InputError, SolverError, TossidError
from tossid.parallel import as_done, in_threads, over_threads


def halved(x: int) -> int:
    if x % 2:
        raise InputError(f"{x} is odd")
    return x // 2


def die_of_three(x: int) -> int:
    if x == 3:
        os._exit(9)
    return x


def test_an_error_of_ours_is_an_outcome_here_and_in_threads() -> None:
    with ThreadPoolExecutor(2) as pool:
        for submit in (None, pool.submit):
            found = {x: str(y) if isinstance(y, TossidError) else y for x, y in as_done(halved, [4, 3, 2], submit)}
            assert found == {4: 2, 3: "3 is odd", 2: 1}


def test_any_other_error_ends_the_work_and_cancels_the_rest() -> None:
    begun, gate = [], Event()

    def divide(x: int) -> float:
        begun.append(x)
        if x:
            gate.wait(10)
        return 1 / x

    with ThreadPoolExecutor(2) as pool:
        with pytest.raises(ZeroDivisionError):
            list(as_done(divide, [0, 1, 2, 3, 4, 5], pool.submit))
        gate.set()
    assert len(begun) < 6


def test_a_worker_that_dies_is_one_error_with_a_count() -> None:
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(SolverError, match="a worker died or was lost"),
    ):
        list(as_done(die_of_three, [3], pool.submit))


def slices(count: int, n_threads: int) -> list[tuple[int, int]]:
    """The slices that a batch is split into, sorted."""
    found: list[tuple[int, int]] = []
    lock = threading.Lock()

    def part(first: int, last: int) -> None:
        with lock:
            found.append((first, last))

    over_threads(part, count, n_threads)
    return sorted(found)


def test_slices_cover_a_batch_once_and_an_error_in_one_is_raised() -> None:
    for count in (0, 1, 7, 100, 1001):
        for n_threads in (1, 2, 3):
            covered = [k for first, last in slices(count, n_threads) for k in range(first, last)]
            assert covered == list(range(count))
    assert slices(100, 1) == [(0, 100)]

    def part(first: int, last: int) -> None:
        raise ValueError(f"slice {first}")

    with pytest.raises(ValueError, match="slice 0"):
        over_threads(part, 100, 2)


def test_batches_of_an_item_are_split_over_threads_that_compute_no_other() -> None:
    both, done = threading.Barrier(2, timeout=60), Event()

    def whole_and_split(wait: bool) -> list[list[tuple[int, int]]]:
        both.wait()
        whole = slices(100, 2)
        both.wait()
        if not wait:
            return [whole]
        assert done.wait(60)
        return [whole, slices(100, 2), next(in_threads(lambda count: slices(count, 2), [100, 200], 2))]

    found = in_threads(whole_and_split, [False, True], 2)
    short = next(found)
    done.set()
    (long,) = found
    assert short == [[(0, 100)]]
    assert long[0] == [(0, 100)]
    assert [len(each) for each in long[1:]] == [12, 12]


def test_items_are_computed_by_threads_in_order() -> None:
    for n_threads in (1, 2):
        assert list(in_threads(halved, range(0, 20, 2), n_threads)) == list(range(10))
    assert [len(each) for each in in_threads(lambda count: slices(count, 2), [100], 2)] == [12]
    with pytest.raises(InputError, match="3 is odd"):
        list(in_threads(halved, [2, 3], 2))
