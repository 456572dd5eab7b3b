"""Many calls of one function, in this process or by any executor, and batches that are split over threads."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import lru_cache, partial
from typing import TypeVar

import numpy as np

from tossid.errors import SolverError, TossidError

T = TypeVar("T")
R = TypeVar("R")


def as_done(
    function: Callable[[T], R], items: Sequence[T], submit: Callable[..., Future[R]] | None = None
) -> Iterator[tuple[T, R | TossidError]]:
    """Each item with the function's result, in the order in which they are done.

    An executor has the work when this returns, before the first result is asked for.

    Args:
        function: What is computed of an item.
        items: The items.
        submit: Of an executor (`concurrent.futures`); None to compute them one after another, in this process.

    Returns:
        Each item, and its result or the `TossidError` that it ended in.

    Raises:
        SolverError: Workers died, or can no longer be reached. The rest is cancelled, as on any other end.
    """
    if submit is None:
        return ((item, _outcome(partial(function, item))) for item in items)
    return _outcomes({submit(function, item): item for item in items})


def _outcomes(waiting: dict[Future[R], T]) -> Iterator[tuple[T, R | TossidError]]:
    total = len(waiting)
    try:
        for done in as_completed(list(waiting)):
            yield waiting.pop(done), _outcome(done.result)
    except BaseException as error:
        for future in waiting:
            future.cancel()
        if not _lost(error):
            raise
        problem = (
            f"a worker died or was lost ({type(error).__name__}; perhaps for lack of memory); what is done is kept, "
            "and the same command continues; fewer workers take less memory"
        )
        raise SolverError(problem, count=len(waiting) + 1, total=total) from error


def _outcome(result: Callable[[], R]) -> R | TossidError:
    try:
        return result()
    except TossidError as error:
        return error


def _lost(error: BaseException) -> bool:
    """Whether workers are gone, not the work wrong."""
    if isinstance(error, (BrokenExecutor, CancelledError)):
        return True
    if "distributed" not in sys.modules:
        return False
    from distributed import KilledWorker
    from distributed.scheduler import NoWorkerError

    return isinstance(error, (KilledWorker, NoWorkerError))


def in_threads(function: Callable[[T], R], items: Iterable[T], n_threads: int) -> Iterator[R]:
    """Each item's result in order, several at once; batches within one (`over_threads`) share threads that are idle.

    Args:
        function: What is computed of an item, mostly in code that needs no interpreter's lock.
        items: The items.
        n_threads: How many at once; with one, or within such an item, one after another as they are asked for.
    """
    items = items if isinstance(items, Sequence) else list(items)
    if n_threads == 1 or len(items) < 2 or _thread.running is not None:
        yield from (function(item) for item in items)
        return
    running = _Running()

    def one(item: T) -> R:
        with running.one_more():
            return function(item)

    with ThreadPoolExecutor(n_threads) as pool:
        yield from pool.map(one, items)


class _Running:
    """How many items of one `in_threads` are computed now."""

    def __init__(self) -> None:
        self.count, self._lock = 0, threading.Lock()

    @contextmanager
    def one_more(self) -> Iterator[None]:
        """This thread computes an item until the block ends."""
        self._add(1)
        _thread.running = self
        try:
            yield
        finally:
            _thread.running = None
            self._add(-1)

    def _add(self, change: int) -> None:
        with self._lock:
            self.count += change


class _ThreadState(threading.local):
    """Of each thread: the items among which it computes one, if it does."""

    running: _Running | None = None


_thread = _ThreadState()


def threads_at_hand(n_threads: int) -> int:
    """How many of some threads may share a batch of this thread: all, or its part where others compute items, too.

    A thread that returns from a slice waits for the interpreter's lock: where several threads split their batches too,
    a diagnosis of 16 tosses on two cores takes 1.6 times as long.

    Args:
        n_threads: Some threads.
    """
    return n_threads if _thread.running is None else max(1, n_threads // _thread.running.count)


def over_threads(part: Callable[[int, int], None], count: int, n_threads: int) -> None:
    """Call part(first, last) for slices of 0..count on several threads; without threads where that is no gain.

    Args:
        part: works on first..last-1.
        count: length of the batch.
        n_threads: each takes eight slices on average, or fewer, so that a slice is at least eight long.
    """
    n_threads = threads_at_hand(n_threads)
    if n_threads <= 1 or count < 2 * n_threads:
        part(0, count)
        return
    slices = max(n_threads, min(8 * n_threads, count // 8))
    edges = np.linspace(0, count, slices + 1).astype(int)
    list(_pool(n_threads).map(part, edges[:-1].tolist(), edges[1:].tolist()))


@lru_cache
def _pool(n_threads: int) -> ThreadPoolExecutor:
    """One pool for all calls: to start threads takes longer than most batches."""
    return ThreadPoolExecutor(n_threads, thread_name_prefix="batches")


if hasattr(os, "register_at_fork"):
    # a forked process has the pools but not their threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
