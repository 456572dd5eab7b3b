"""Sums of Gauss-Newton, toss by toss, and an average of the quadratics that they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class GaussNewton(NamedTuple):
    """Gauss-Newton's sums, toss by toss.

    Attributes:
        H: (n_tosses, P, P) weighted J^T J.
        g: (n_tosses, P) weighted J^T error.
        x: (P,) parameters at which they were taken.
        calm: (S, L) marks the frames that count in them.
    """

    H: Array
    g: Array
    x: Array
    calm: NDArray[np.bool_]


@dataclass(frozen=True)
class Averaged:
    """The sum of quadratics x^T H x / 2 - b^T x, the k-th weighted with k.

    Attributes:
        H: (P, P).
        b: (P,).
        count: How many.
    """

    H: Array
    b: Array
    count: int = 0

    def with_quadratic(self, H: Array, b: Array) -> Averaged:
        """The sum with one more.

        Args:
            H: (P, P) of it.
            b: (P,) of it.
        """
        k = self.count + 1
        return Averaged(self.H + k * H, self.b + k * b, k)
