"""Rows that are equal, each to be computed once: a toss that is drawn twice makes the same windows twice (Numba)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel

_FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""Of a multiplicative hash (Knuth, The Art of Computer Programming, vol. 3, section 6.4)."""
_HALF = np.uint64(32)


def distinct(*columns: NDArray[np.float64] | NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which of n rows are distinct, to the bit.

    Args:
        columns: (n,) or (n, k) each, of 8 bytes a number; a row is what stands in all of them.

    Returns:
        (d,) numbers of the distinct rows, in order, and (n,) for each row its place among these.
    """
    parts = [np.ascontiguousarray(each).reshape(len(each), -1).view(np.uint64) for each in columns]
    key = np.zeros(len(parts[0]), dtype=np.uint64)
    for part in parts:
        _hash(part, key)
    in_order, every = np.sort(key), np.arange(len(key))
    if (in_order[1:] != in_order[:-1]).all():
        return every, every
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rows, place = first[order], np.argsort(order)[place]
    if not all(np.array_equal(part, part[rows[place]]) for part in parts):  # two rows of one key
        return every, every
    return rows, place


@kernel(allocates=False)
def _hash(bits: NDArray[np.uint64], key: NDArray[np.uint64]) -> None:
    """Bring keys (n,) of rows up to date with further columns (n, k): equal rows have equal keys."""
    for i in range(len(bits)):
        found = key[i]
        for j in range(bits.shape[1]):
            found = (found ^ bits[i, j]) * _FACTOR
            found ^= found >> _HALF
        key[i] = found
