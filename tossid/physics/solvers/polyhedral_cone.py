"""The polyhedral friction cone in the time stepper."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tossid.errors import InputError
from tossid.physics.solvers.lcp import lcp_kernel, lcp_scratch
from tossid.physics.solvers.polyhedral_problem import PolyhedralAnswer, PolyhedralProblem
from tossid.physics.solvers.registry import register_solver


class PolyhedralCone(NamedTuple):
    """The polyhedral friction cone of Stewart and Trinkle, solved as an LCP by Lemke's algorithm (`lcp`).

    Attributes:
        n_directions: of the cone, an even number from 4.
        max_iterations: pivots.
    """

    n_directions: int = 8
    max_iterations: int = 2000

    def check(self, relaxed: bool) -> None:
        """Refuse an odd number of directions, and the convex relaxation of Coulomb's law.

        Args:
            relaxed: whether contacts near the ground follow that relaxation.

        Raises:
            InputError: n_directions is odd or below 4, or `relaxed`.
        """
        if self.n_directions < 4 or self.n_directions % 2:
            raise InputError(f"n_directions is {self.n_directions}, expected an even number from 4")
        if relaxed:
            raise InputError("the convex relaxation of Coulomb's law ('lifting') needs the solver ExactCone()")


@register_solver(PolyhedralCone)
def _solve(solver, A, b, mu, lam, tolerance):  # type: ignore[no-untyped-def]
    n, k = mu.shape[0], solver.n_directions
    directions = np.empty((k, 2))
    for j in range(k):
        directions[j, 0], directions[j, 1] = math.cos(2.0 * math.pi * j / k), math.sin(2.0 * math.pi * j / k)
    problem = PolyhedralProblem(A, b, mu, directions)
    answer = PolyhedralAnswer(lam, np.empty((n, k)), np.empty(n))
    status, kkt_error, _ = lcp_kernel(problem, answer, tolerance, solver.max_iterations, lcp_scratch(n, k))
    return status, kkt_error
