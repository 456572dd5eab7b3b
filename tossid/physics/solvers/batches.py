"""What the batch functions share: checked, contiguous arrays, and a batch split over threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tossid.errors import InputError
from tossid.physics.solvers.problem import Array


class Problems(NamedTuple):
    """A batch of contact problems, contiguous; rows in the order of `problem`.

    Attributes:
        A: (B, 3 n, 3 n) Delassus matrices [1/kg].
        b: (B, 3 n) [m/s]; of cone programmes, their linear term c.
        mu: (B, n) friction coefficients.
    """

    A: Array
    b: Array
    mu: Array


def check_batch(A: Array, b: Array, mu: Array, warm: Array | None) -> tuple[Problems, Array]:
    """The problems as the kernels read them, and impulses (B, 3 n) to start from.

    Args:
        A: (B, 3 n, 3 n).
        b: (B, 3 n).
        mu: (), (n,) or (B, n).
        warm: (B, 3 n), which is copied; zero if None.

    Returns:
        The problems, and the impulses.

    Raises:
        InputError: shapes that do not fit, or a negative mu.
    """
    A, b = np.ascontiguousarray(A, dtype=float), np.ascontiguousarray(b, dtype=float)
    if b.ndim != 2 or b.shape[1] % 3 or A.shape != (*b.shape, b.shape[1]):
        raise InputError(f"contact problems of shapes A {A.shape} and b {b.shape}; expected (B, 3 n, 3 n) and (B, 3 n)")
    count, n = b.shape[0], b.shape[1] // 3
    mu = np.asarray(mu, dtype=float)
    if mu.shape not in ((), (n,), (count, n)):
        raise InputError(f"friction of shape {mu.shape}, expected ({n},) or ({count}, {n})")
    if (mu < 0).any():
        raise InputError(f"friction coefficient {mu.min():g} is negative")
    mu = np.ascontiguousarray(np.broadcast_to(mu, (count, n)))
    if warm is not None and np.shape(warm) != b.shape:
        raise InputError(f"warm start of shape {np.shape(warm)}, expected {b.shape}")
    lam = np.zeros(b.shape) if warm is None else np.array(warm, dtype=float, order="C")
    return Problems(A, b, mu), lam


_here = threading.local()


@contextmanager
def whole_batches() -> Iterator[None]:
    """In this thread, batches are not split: several of such threads are at work already.

    A thread that returns from a slice waits for the interpreter's lock: where several threads split their batches too,
    a diagnosis of 16 tosses on two cores takes 1.6 times as long.
    """
    before, _here.whole = is_one_of_several(), True
    try:
        yield
    finally:
        _here.whole = before


def is_one_of_several() -> bool:
    """Whether this thread is within `whole_batches`."""
    return bool(getattr(_here, "whole", False))


def over_threads(part: Callable[[int, int], None], count: int, n_threads: int) -> None:
    """Call part(first, last) for slices of 0..count on several threads; without threads where that is no gain.

    Args:
        part: works on first..last-1.
        count: length of the batch.
        n_threads: each takes four slices on average.
    """
    if n_threads <= 1 or count < 2 * n_threads or is_one_of_several():
        part(0, count)
        return
    edges = np.linspace(0, count, 4 * n_threads + 1).astype(int)
    list(_pool(n_threads).map(part, edges[:-1].tolist(), edges[1:].tolist()))


@lru_cache
def _pool(n_threads: int) -> ThreadPoolExecutor:
    """One pool for all calls: to start threads takes longer than most batches."""
    return ThreadPoolExecutor(n_threads, thread_name_prefix="batches")


if hasattr(os, "register_at_fork"):
    # a forked process has the pools but not their threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
