"""Many calls: outcomes of ours are handed on, anything else ends the work."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from threading import Event

import pytest

from tossid.errors import InputError, SolverError, TossidError
from tossid.parallel import as_done


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
