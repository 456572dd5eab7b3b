"""What a contact problem is, how its answer is judged, and how it can fail (NumPy, plain).

One time step with n contacts has the impulses lam (3 n,) [N s] in the order

    lam = [n_1 .. n_n, t1_1, t2_1, t1_2, t2_2, ..]

and the contact velocities after the step w = A lam + b [m/s], with the Delassus
matrix A = J M^-1 J^T (3 n, 3 n) [1/kg], symmetric and positive semi-definite, and
b_n = phi / dt + J_n v_free, b_t = J_t v_free.

Exact cone (maximum dissipation, Moreau 1988; Stewart & Trinkle 1996):

    0 <= lam_n  _|_  w_n >= 0,    lam_t = argmin over |lam_t| <= mu lam_n of lam_t . w_t

Cone programme (the inner problem of the ContactNets loss, Pfrommer et al. 2020):

    min over lam_n >= 0, |lam_t| <= mu lam_n of  1/2 lam^T A lam + c^T lam

KKT errors are natural maps, zero exactly at a solution. Impulses are weighed with
a_i = trace(A_ii) / 3 of the contact's own block, so that every KKT error is a velocity
[m/s] (or the unit of c) and a problem scaled in mass keeps its KKT error.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SolverStatus(IntEnum):
    """How a contact problem ended. Anything but SOLVED is counted and reported by the caller."""

    SOLVED = 0
    """The KKT error is at or below the tolerance."""

    MAX_ITERATIONS = 1
    """The iteration limit came first: raise it, or look for contacts that exclude each other."""

    INFEASIBLE = 2
    """No impulse keeps the contacts apart, or the programme has no minimum (a ray termination)."""

    NOT_FINITE = 3
    """The problem holds NaN or infinity; the impulses are returned as zero."""

    INACCURATE = 4
    """The method came to its end, but rounding keeps the KKT error above the tolerance."""


class ContactSolution(NamedTuple):
    """Solved contact problems.

    Attributes:
        lam: (B, 3 n) impulses [N s].
        status: (B,) `SolverStatus` values.
        kkt_error: (B,) [m/s].
    """

    lam: Array
    status: NDArray[np.uint8]
    kkt_error: Array

    @property
    def unsolved(self) -> int:
        """How many problems of the batch met no tolerance."""
        return int(np.count_nonzero(self.status != SolverStatus.SOLVED))
