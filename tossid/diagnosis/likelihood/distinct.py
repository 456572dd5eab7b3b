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
    bits = np.concatenate(
        [np.ascontiguousarray(each).reshape(len(each), -1).view(np.uint64) for each in columns], axis=1
    )
    key = np.empty(len(bits), dtype=np.uint64)
    _hash(bits, key)
    in_order = np.sort(key)
    if (in_order[1:] != in_order[:-1]).all():
        return np.arange(len(bits)), np.arange(len(bits))
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rows, place = first[order], np.argsort(order)[place]
    if not np.array_equal(bits, bits[rows[place]]):  # two rows of one key
        return np.arange(len(bits)), np.arange(len(bits))
    return rows, place


@kernel(allocates=False)
def _hash(bits: NDArray[np.uint64], key: NDArray[np.uint64]) -> None:
    """A key (n,) of each row (n, k): equal rows have the same."""
    for i in range(len(bits)):
        found = np.uint64(0)
        for j in range(bits.shape[1]):
            found = (found ^ bits[i, j]) * _FACTOR
            found ^= found >> _HALF
        key[i] = found
