"""Rows that are equal, so that each is computed once: a toss that is drawn twice makes the same windows twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    key = np.zeros(len(bits), dtype=np.uint64)
    for column in bits.T:
        key = (key ^ column) * _FACTOR
        key ^= key >> _HALF
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rows, place = first[order], np.argsort(order)[place]
    if not np.array_equal(bits, bits[rows[place]]):  # two rows of one key
        return np.arange(len(bits)), np.arange(len(bits))
    return rows, place
