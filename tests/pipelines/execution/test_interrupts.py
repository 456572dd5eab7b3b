"""Ctrl-C waits until what must not be left half done is done."""

from __future__ import annotations

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from pipelines.execution.interrupts import interrupted_later


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_the_end_and_handlers_come_back(number: signal.Signals) -> None:
    before, done = signal.getsignal(number), []
    with pytest.raises(KeyboardInterrupt), interrupted_later():
        signal.raise_signal(number)
        done.append(1)
    assert done == [1]
    assert signal.getsignal(number) is before


def test_a_thread_leaves_handlers_alone() -> None:
    def within() -> object:
        with interrupted_later():
            return signal.getsignal(signal.SIGINT)

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(within).result() is signal.getsignal(signal.SIGINT)
