"""What contact holds beside its impulses: adhesion, and resistance to spin."""

from __future__ import annotations

import math

from tossid.kernels import fused_lean_kernel, lean_kernel
from tossid.physics.cholesky import solve_rates
from tossid.physics.contact.law import ADHESION_REACH
from tossid.physics.contact.problem import FAR
from tossid.physics.moving import inverse_mass, n_rates, spin_row


@fused_lean_kernel
def resist(impulse, L, row, y, xi):  # type: ignore[no-untyped-def]
    """Take an angular impulse [N m s] against the spin row . xi, no more than stops it. y: scratch."""
    nx, spin, size = xi.shape[0], 0.0, 0.0
    for x in range(nx):
        y[x] = row[x]
        spin += row[x] * xi[x]
    solve_rates(L, y, nx)
    for x in range(nx):
        size += row[x] * y[x]
    s = math.copysign(min(impulse, abs(spin) / size), spin)
    for x in range(nx):
        xi[x] -= s * y[x]


@lean_kernel
def adhere(model, law, work, s, corners, h):  # type: ignore[no-untyped-def]
    """Adhesion's pull on the free s.u and s.xi.

    Every corner that carried load in the last step, or is within `ADHESION_REACH`, is pulled down by the same force:
    u_n -= h f / m, xi -= h f S^-1 tau_n.
    """
    nx, y, pull = n_rates(model), corners.g, h * law.beyond.adhesion
    for c in range(corners.state.shape[0]):
        near = corners.height[c] < ADHESION_REACH or corners.warm[c, 0] > 0.0
        if pull != 0.0 and near and corners.state[c] != FAR:
            for x in range(nx):
                y[x] = corners.tau[c, 0, x]
            solve_rates(work.L, y, nx)
            s.u[0] -= pull * inverse_mass(model, work)
            for x in range(nx):
                s.xi[x] -= pull * y[x]


@lean_kernel
def find_spin_taken(model, law, work, s, corners, loaded):  # type: ignore[no-untyped-def]
    """s.taken: what contact takes of s.xi for its corners' loads, if there are any. s.xi stays."""
    nx = n_rates(model)
    for x in range(nx):
        s.taken[x] = s.xi[x]
    if loaded:
        resist_spins(model, law, work, s, corners)
    for x in range(nx):
        before = s.taken[x]
        s.taken[x] = s.xi[x] - before
        s.xi[x] = before


@lean_kernel
def resist_spins(model, law, work, s, corners):  # type: ignore[no-untyped-def]
    """Take from s.xi what contact resists of each body's spin, in proportion to its corners' loads [N s].

    About the vertical by `torsional`, about the horizontal by `rolling`: a torque stops spin and never turns it.
    """
    beyond, R, nx, row = law.beyond, s.R, n_rates(model), work.row
    for b in range(model.parent.shape[0]):
        load = 0.0
        for c in range(corners.state.shape[0]):
            if model.corner_body[c] == b:
                load += corners.load[c]
        if load == 0.0:
            continue
        spin_row(model, work, b, R[2, 0], R[2, 1], R[2, 2], row)
        resist(beyond.torsional * load, work.L, row, corners.g, s.xi)
        across0, across1 = 0.0, 0.0
        spin_row(model, work, b, R[0, 0], R[0, 1], R[0, 2], row)
        for x in range(nx):
            across0 += row[x] * s.xi[x]
        spin_row(model, work, b, R[1, 0], R[1, 1], R[1, 2], row)
        for x in range(nx):
            across1 += row[x] * s.xi[x]
        size = math.sqrt(across0 * across0 + across1 * across1)
        if size > 0.0:
            d0, d1 = across0 / size, across1 / size
            a0, a1 = d0 * R[0, 0] + d1 * R[1, 0], d0 * R[0, 1] + d1 * R[1, 1]
            spin_row(model, work, b, a0, a1, d0 * R[0, 2] + d1 * R[1, 2], row)
            resist(beyond.rolling * load, work.L, row, corners.g, s.xi)
