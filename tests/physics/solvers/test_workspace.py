"""The moves that the cone solvers make in their work array, each against the line of algebra that it is."""

from __future__ import annotations

import numpy as np

from tests.physics.solvers.contact_problems import BOTTOM, INERTIA, MASS, UP, delassus
from tests.physics.solvers.reference import contact_scale
from tossid.kernels import kernel
from tossid.physics.solvers import workspace as ws
from tossid.physics.solvers.problem import contact_rows

RNG = np.random.default_rng(0)


@kernel(keep=False)
def shifted(A, V, index, x, m):  # type: ignore[no-untyped-def]
    """Set contact 1's impulse to x; the velocity that it would have without any."""
    ws.contact_scales(A, V, m)
    ws.multiply(A, V, ws.LAM, ws.W, m)
    ws.shift(A, V, 3, x[0], x[1], x[2], m)
    return ws.velocity_without(A, V, 3)


@kernel(keep=False)
def moved(V, index, m, size, length):  # type: ignore[no-untyped-def]
    ws.manifold_step(V, index, m, size, length)


@kernel(keep=False)
def exits(y, d, mu):  # type: ignore[no-untyped-def]
    return ws.cone_exit(y[0], y[1], y[2], d[0], d[1], d[2], mu)


@kernel(keep=False)
def there_and_back(A, b, mu, lam, V, local):  # type: ignore[no-untyped-def]
    n = mu.shape[0]
    ws.gather(b, mu, lam, V)
    ws.gather_matrix(A, local, n)
    lam[:] = -1.0
    ws.scatter(lam, V, n, ws.SOLVED)


def contact_major() -> tuple[np.ndarray, np.ndarray]:
    """A of four corners (12, 12), contact after contact, and the rows' order."""
    _, A = delassus(BOTTOM, np.tile(UP, (4, 1)), MASS, np.full(3, INERTIA))
    order = np.ravel([contact_rows(i, 4) for i in range(4)])
    return np.ascontiguousarray(A[np.ix_(order, order)]), order


def test_a_shift_keeps_the_velocity_up_to_date() -> None:
    A, order = contact_major()
    V, index = ws.work_arrays(4)
    V[ws.LAM, :12], V[ws.B, :12] = RNG.normal(size=(2, 12))
    V[ws.LAM, 6:9] = 0.0
    x = RNG.normal(size=3)
    without = shifted(A, V, index, x, 4)
    np.testing.assert_array_equal(V[ws.LAM, 3:6], x)
    np.testing.assert_allclose(V[ws.W, :12], A @ V[ws.LAM, :12] + V[ws.B, :12], atol=1e-12)
    np.testing.assert_allclose(without, V[ws.W, 3:6] - A[3:6, 3:6] @ x, atol=1e-12)
    caller = np.empty_like(A)
    caller[np.ix_(order, order)] = A
    np.testing.assert_allclose(V[ws.SCALE, :4], contact_scale(caller), rtol=1e-14)


def test_a_step_puts_contacts_back_into_their_states() -> None:
    V, index = ws.work_arrays(3)
    V[ws.LAM, :9] = [1.0, 0.1, 0.2, 1.0, 0.3, 0.4, 1.0, 0.0, 0.1]
    V[ws.MU, :3] = 0.5
    index[ws.KIND, :3] = [ws.STICK, ws.SLIP, ws.STICK]
    for u in range(9):  # each unknown is one component
        V[ws.BASIS + u % 3, u], index[ws.ROW, u] = 1.0, 3 * (u // 3)
    V[ws.X, :9] = [0.0, 2.0, 0.0, 0.0, -0.2, -0.3, -5.0, 0.0, 0.0]
    moved(V, index, 3, 9, 1.0)
    trial = V[ws.TRIAL, :9].reshape(3, 3)
    assert trial[0, 0] == 1.0  # sticking: into the cone, in its direction
    np.testing.assert_allclose(trial[0, 1:], 0.5 * np.array([2.1, 0.2]) / np.hypot(2.1, 0.2))
    np.testing.assert_allclose(trial[1, 1:], 0.5 * np.array([0.1, 0.1]) / np.hypot(0.1, 0.1))  # slipping: on it
    np.testing.assert_array_equal(trial[2], 0.0)  # pulling: at zero


def test_a_step_out_of_the_cone_is_cut_at_its_surface() -> None:
    left = 0
    for _ in range(200):
        mu, y, d = RNG.uniform(0.1, 1.5), RNG.normal(size=3), 3 * RNG.normal(size=3)
        y[0] = np.hypot(y[1], y[2]) / mu * RNG.uniform(1, 2)
        part = exits(y, d, mu)
        end = y + part * d
        assert np.hypot(end[1], end[2]) <= mu * end[0] + 1e-9
        if part < 1.0:
            left += 1
            assert np.hypot(end[1], end[2]) >= mu * end[0] - 1e-9
    assert 20 < left < 200


def test_contacts_are_gathered_and_scattered() -> None:
    n = 4
    A, b, mu, lam = RNG.normal(size=(12, 12)), RNG.normal(size=12), RNG.uniform(size=4), RNG.normal(size=12)
    V, _ = ws.work_arrays(n)
    local, before = np.zeros((12, 12)), lam.copy()
    there_and_back(A, b, mu, lam, V, local)
    rows = np.ravel([contact_rows(i, n) for i in range(n)])
    np.testing.assert_array_equal(V[ws.B, :12], b[rows])
    np.testing.assert_array_equal(V[ws.MU, :4], mu)
    np.testing.assert_array_equal(local, A[np.ix_(rows, rows)])
    np.testing.assert_array_equal(lam, before)
