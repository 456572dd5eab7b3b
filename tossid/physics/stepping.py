"""Time stepping with contact: Stewart and Trinkle's scheme over batches of tosses.

One step of length h from (q, v), with a the acceleration without contact:

    v_free = v + h a(q, v)
    find the corners' impulses lam with  0 <= lam_n  _|_  phi(q) + h J_n v' >= 0  and Coulomb friction
    v' = v_free + M^-1 J^T lam
    q' = q moved along v' if anything touches, else along (v + v') / 2 (exact for constant a)

Stewart and Trinkle, "An implicit time-stepping scheme for rigid body dynamics
with inelastic collisions and Coulomb friction", IJNME 1996. Restitution, where
there is any, is Newton's: an approaching corner must leave with J_n v' >= -e J_n v.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.physics.body import make_body, simulate_body
from tossid.physics.free import free_acceleration
from tossid.physics.solvers import cone_core, cone_work, lcp_kernel, lcp_work, tangent_directions
from tossid.physics.solvers.batches import over_threads
from tossid.physics.system import System
from tossid.physics.tree import integrate_configuration, make_work, point_jacobian

Array = NDArray[np.float64]

TOLERANCE = 1e-7
"""Residual [m/s] below which a step's contact problem counts as solved."""
MAX_ITERATIONS = 100
CLOSING_SPEED = 1.0
"""A corner joins the contact problem at once if it would touch within this speed [m/s]; others when they are hit."""
BOUNCE_SPEED = 0.02
"""Approach [m/s] below which restitution does not act."""

_jit = numba.njit(cache=True, error_model="numpy", nogil=True)


class Simulation(NamedTuple):
    """Simulated tosses.

    q (B, T + 1, nq), v (B, T + 1, nv); frames past a toss's own number of steps
    hold its last state. lam_n (B, T, n_c): normal impulse of each corner over the
    frame [N s]. unsolved (B,): steps whose contact problem missed the tolerance.
    residual (B,): the largest residual met [m/s]. finite (B,): False where a state
    became NaN or infinite, or M lost its definiteness: the toss stays at its last finite state.
    """

    q: Array
    v: Array
    lam_n: Array
    unsolved: NDArray[np.int64]
    residual: Array
    finite: NDArray[np.bool_]


class _Scratch(NamedTuple):
    J: Array  # (3 n_c, nv) contact-major rows n, t1, t2 of the candidates
    Y: Array  # (3 n_c, nv) rows of (L^-1 J^T)^T
    A: Array  # (3 n_c, 3 n_c) Delassus matrix, contact-major
    b: Array  # (3 n_c,)
    lam: Array  # (3 n_c,)
    mu: Array  # (n_c,)
    warm: Array  # (n_c, 3) impulses of the last step
    height: Array  # (n_c,)
    rows: Array  # (n_c, 3, nv) Jacobian of every low corner: normal, t1, t2
    corner: NDArray[np.int64]  # (n_c,) corner of each candidate
    state: NDArray[np.int8]  # (n_c,) 0 far, 1 low, 2 candidate
    solver_work: Array
    solver_index: NDArray[np.int64]
    lcp_work: Array
    lcp_index: NDArray[np.int64]
    directions: Array  # (k, 2), k = 0 for the exact cone


def _scratch(system: System, n_directions: int) -> _Scratch:
    nc, nv = system.n_corners, system.nv
    work, index = cone_work(nc)
    k = n_directions
    lemke_work, lemke_index = lcp_work(nc, k) if k else (np.zeros((1, 1)), np.zeros((1, 1), dtype=np.int64))
    z = np.zeros
    return _Scratch(
        z((3 * nc, nv)),
        z((3 * nc, nv)),
        z((3 * nc, 3 * nc)),
        z(3 * nc),
        z(3 * nc),
        z(nc),
        z((nc, 3)),
        z(nc),
        z((nc, 3, nv)),
        z(nc, dtype=np.int64),
        z(nc, dtype=np.int8),
        work,
        index,
        lemke_work,
        lemke_index,
        tangent_directions(k) if k else z((0, 2)),
    )


@_jit
def _link_rows(system, work, c, z, J, rows):  # type: ignore[no-untyped-def]
    """Jacobian of corner c at height z into rows[c] (3, nv): normal, t1 (world x), t2 (world y); any body."""
    body = system.corner_body[c]
    x = np.empty(3)
    for i in range(2):
        x[i] = work.xpos[body, i]
        for j in range(3):
            x[i] += work.xmat[body, i, j] * system.corner_pos[c, j]
    x[2] = z
    point_jacobian(system, work, body, x, J[:3])
    for j in range(rows.shape[2]):
        rows[c, 0, j], rows[c, 1, j], rows[c, 2, j] = J[2, j], J[0, j], J[1, j]


@_jit
def _find_low_corners(system, work, s, vf, h):  # type: ignore[no-untyped-def]
    """Heights, Jacobians and states of the corners; returns how many could be hit at all."""
    nv = vf.shape[0]
    body_of, corner, x, R, rows = system.corner_body, system.corner_pos, work.xpos, work.xmat, s.rows
    low = 0
    speed = abs(vf[2])
    for j in range(3, nv):
        speed += 0.2 * abs(vf[j])
    reach = 0.02 + 3.0 * h * speed  # farther than a corner moves in a step, contact included
    for c in range(body_of.shape[0]):
        body = body_of[c]
        p0, p1, p2 = corner[c, 0], corner[c, 1], corner[c, 2]
        z = x[body, 2] + R[body, 2, 0] * p0 + R[body, 2, 1] * p1 + R[body, 2, 2] * p2
        s.height[c] = z
        s.state[c] = 0
        if not z < reach:
            continue
        low += 1
        if body == 0:  # a base corner's velocity is v + R (omega x p)
            for k in range(3):
                i = 2 if k == 0 else k - 1
                for j in range(nv):
                    rows[c, k, j] = 0.0
                rows[c, k, i] = 1.0
                rows[c, k, 3] = p1 * R[0, i, 2] - p2 * R[0, i, 1]
                rows[c, k, 4] = p2 * R[0, i, 0] - p0 * R[0, i, 2]
                rows[c, k, 5] = p0 * R[0, i, 1] - p1 * R[0, i, 0]
        else:
            _link_rows(system, work, c, z, s.J, rows)
        vn = 0.0
        for j in range(nv):
            vn += rows[c, 0, j] * vf[j]
        s.state[c] = 2 if z / h + vn < CLOSING_SPEED else 1
    return low


@_jit
def _assemble(system, work, s, v, vf, h):  # type: ignore[no-untyped-def]
    """The candidates' contact problem (J, Y, A, b, warm start), contact-major; returns their number."""
    nv = vf.shape[0]
    J, Y, A, rows, L = s.J, s.Y, s.A, s.rows, work.L
    n = 0
    closed = True
    for c in range(s.state.shape[0]):
        if s.state[c] != 2:
            continue
        for k in range(3):
            r = 3 * n + k
            free, before = 0.0, 0.0
            for j in range(nv):
                row = rows[c, k, j]
                J[r, j] = row
                free += row * vf[j]
                before += row * v[j]
            if k == 0:
                target = s.height[c] / h + free
                if system.restitution > 0.0 and target < 0.0 and before < -BOUNCE_SPEED:
                    target = min(target, free + system.restitution * before)
                s.b[r] = target
                closed = closed and target >= 0.0
            else:
                s.b[r] = free
            s.lam[r] = s.warm[c, k]
        s.mu[n] = system.mu[c]
        s.corner[n] = c
        n += 1
    if closed:
        return 0
    for r in range(3 * n):
        for i in range(nv):
            t = J[r, i]
            for k in range(i):
                t -= L[i, k] * Y[r, k]
            Y[r, i] = t / L[i, i]
        for r2 in range(r + 1):
            t = 0.0
            for i in range(nv):
                t += Y[r, i] * Y[r2, i]
            A[r, r2] = t
            A[r2, r] = t
    return n


@_jit
def _solve(s, n, tolerance):  # type: ignore[no-untyped-def]
    """Impulses of the assembled problem into s.lam; returns (status, residual)."""
    k = s.directions.shape[0]
    if k == 0:
        status, residual, _ = cone_core(
            s.A, s.b, s.mu, s.lam, n, tolerance, MAX_ITERATIONS, s.solver_work, s.solver_index
        )
        if status != 0:  # once more from zero: a poor warm start is the usual reason
            s.lam[: 3 * n] = 0.0
            status, residual, _ = cone_core(
                s.A, s.b, s.mu, s.lam, n, tolerance, 5 * MAX_ITERATIONS, s.solver_work, s.solver_index
            )
        return status, residual
    A, b, lam = np.empty((3 * n, 3 * n)), np.empty(3 * n), np.empty(3 * n)
    order = np.empty(3 * n, np.int64)
    for i in range(n):
        order[3 * i], order[3 * i + 1], order[3 * i + 2] = i, n + 2 * i, n + 2 * i + 1
    for r in range(3 * n):
        b[order[r]] = s.b[r]
        for r2 in range(3 * n):
            A[order[r], order[r2]] = s.A[r, r2]
    beta, gamma = np.empty((n, k)), np.empty(n)
    status, residual, _ = lcp_kernel(
        A, b, s.mu[:n], np.ones(n, np.bool_), s.directions, lam, beta, gamma, tolerance, 2000, s.lcp_work, s.lcp_index
    )
    for r in range(3 * n):
        s.lam[r] = lam[order[r]]
    return status, residual


@_jit
def _apply_contact(system, work, s, v, vf, h, tolerance):  # type: ignore[no-untyped-def]
    """Contact impulses of one step; vf becomes v'. Returns (touched, status, residual)."""
    nv = vf.shape[0]
    low = _find_low_corners(system, work, s, vf, h)
    if low == 0:
        s.warm[:] = 0.0
        return False, 0, 0.0
    y = np.empty(nv)
    for _ in range(4):
        n = _assemble(system, work, s, v, vf, h)
        if n == 0:
            s.warm[:] = 0.0
            return False, 0, 0.0
        status, residual = _solve(s, n, tolerance)
        y[:] = 0.0
        touched = False
        for r in range(3 * n):
            if s.lam[r] != 0.0:
                touched = True
                for i in range(nv):
                    y[i] += s.Y[r, i] * s.lam[r]
        for i in range(nv - 1, -1, -1):
            t = y[i]
            for k in range(i + 1, nv):
                t -= work.L[k, i] * y[k]
            y[i] = t / work.L[i, i]
        hit = False
        for c in range(s.state.shape[0]):
            if s.state[c] == 1:
                vn = 0.0
                for j in range(nv):
                    vn += s.rows[c, 0, j] * (vf[j] + y[j])
                if s.height[c] / h + vn < 0.0:
                    s.state[c] = 2
                    hit = True
        if not hit:
            break
    s.warm[:] = 0.0
    for i in range(n):
        for k in range(3):
            s.warm[s.corner[i], k] = s.lam[3 * i + k]
    for i in range(nv):
        vf[i] += y[i]
    return touched, status, residual


@_jit
def _simulate(  # type: ignore[no-untyped-def]
    system, work, s, q0, v0, n_steps, dt, substeps, tolerance, first, last, qs, vs, lam_n, unsolved, worst, finite
):
    nq, nv = q0.shape[1], v0.shape[1]
    acc, vf = np.empty(nv), np.empty(nv)
    q, v, moved = np.empty(nq), np.empty(nv), np.empty(nq)
    h = dt / substeps
    for toss in range(first, last):
        q[:] = q0[toss]
        v[:] = v0[toss]
        s.warm[:] = 0.0
        qs[toss, 0], vs[toss, 0] = q, v
        for step in range(n_steps[toss]):
            for _ in range(substeps):
                good = free_acceleration(system, q, v, work, acc)
                for i in range(nv):
                    vf[i] = v[i] + h * acc[i]
                touched, status, residual = _apply_contact(system, work, s, v, vf, h, tolerance)
                if touched:
                    for c in range(s.warm.shape[0]):
                        lam_n[toss, step, c] += s.warm[c, 0]
                    integrate_configuration(q, vf, h, moved)
                else:
                    for i in range(nv):
                        acc[i] = 0.5 * (v[i] + vf[i])
                    integrate_configuration(q, acc, h, moved)
                total = 0.0
                for i in range(nq):
                    total += abs(moved[i])
                for i in range(nv):
                    total += abs(vf[i])
                if not (good and total < 1e9):
                    finite[toss] = False
                    break
                if status != 0:
                    unsolved[toss] += 1
                worst[toss] = max(worst[toss], residual)
                q[:] = moved
                v[:] = vf
            if not finite[toss]:
                break
            qs[toss, step + 1], vs[toss, step + 1] = q, v
        reached = step + 1 if finite[toss] else step
        for rest in range(reached + 1, qs.shape[1]):
            qs[toss, rest], vs[toss, rest] = q, v


def simulate(
    system: System,
    q0: Array,
    v0: Array,
    *,
    n_steps: int | NDArray[np.int64],
    dt: float,
    substeps: int = 1,
    n_directions: int = 0,
    tolerance: float = TOLERANCE,
    n_threads: int = 1,
) -> Simulation:
    """Simulate a batch of tosses.

    Args:
        system: the simulator's parameters.
        q0: (B, nq), v0: (B, nv) initial states.
        n_steps: frames to simulate, one number or one a toss (B,), at least 1.
        dt: time between frames [s], at least `substeps` steps each.
        n_directions: 0 for the exact friction cone; k >= 4 (even) for the polyhedral
            cone of k directions, solved as an LCP by Lemke's algorithm.
        tolerance: on the contact problem's residual [m/s].
        n_threads: tosses are split over this many threads.

    Raises:
        InputError: shapes that do not fit, or numbers out of range.
    """
    q0, v0 = np.ascontiguousarray(q0, dtype=float), np.ascontiguousarray(v0, dtype=float)
    count = len(q0)
    if q0.shape != (count, system.nq) or v0.shape != (count, system.nv):
        raise InputError(
            f"initial states of shapes {q0.shape} and {v0.shape}, expected (B, {system.nq}) and (B, {system.nv})"
        )
    steps = np.ascontiguousarray(np.broadcast_to(np.asarray(n_steps, dtype=np.int64), (count,)))
    if (steps < 1).any() or substeps < 1 or not dt > 0:
        raise InputError("a simulation needs dt > 0, at least one step a toss and at least one substep a step")
    if n_directions and (n_directions < 4 or n_directions % 2):
        raise InputError(f"n_directions is {n_directions}, expected 0 (exact cone) or an even number from 4")
    T = int(steps.max())
    out = Simulation(
        q=np.empty((count, T + 1, system.nq)),
        v=np.empty((count, T + 1, system.nv)),
        lam_n=np.zeros((count, T, system.n_corners)),
        unsolved=np.zeros(count, dtype=np.int64),
        residual=np.zeros(count),
        finite=np.ones(count, dtype=bool),
    )

    body = make_body(system) if n_directions == 0 else None

    def part(first: int, last: int) -> None:
        if body is not None:
            simulate_body(
                *body, *system.residual, q0, v0, steps, float(dt), substeps, tolerance, MAX_ITERATIONS, CLOSING_SPEED,
                BOUNCE_SPEED, first, last, *out, *cone_work(system.n_corners),
            )  # fmt: skip
            return
        work, scratch = make_work(system), _scratch(system, n_directions)
        _simulate(system, work, scratch, q0, v0, steps, float(dt), substeps, tolerance, first, last, *out)

    over_threads(part, count, n_threads)
    return out
