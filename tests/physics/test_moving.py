"""What the time step asks of an object: contact rows, their change and J M^-1 J^T, by the plain equations."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.kernels import kernel
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import make_system, tree
from tossid.physics.body import make_body
from tossid.physics.contact.problem import make_corners
from tossid.physics.forces import Law
from tossid.physics.links import make_links
from tossid.physics.moving import (
    accelerate,
    common_velocity,
    contact_row,
    corner_place,
    falling,
    inverse_mass,
    kinematics,
    make_state,
    n_rates,
    turning,
    whiten,
)
from tossid.physics.time_step import rotation
from tossid.rotations import quat_exp, quat_mul


@kernel(keep=False)
def rows(model, work, s, corners, accelerations):  # type: ignore[no-untyped-def]
    """Corners' rows, their whitened columns and (n_c, 3, 2) accelerations; (1 / m, the common centre's velocity)."""
    rotation(s.q, s.R)
    for x in range(n_rates(model)):
        s.xi_start[x] = s.v[3 + x]
    kinematics(model, work, s)
    accelerate(model, work, s, 1e-3)
    for c in range(corners.state.shape[0]):
        corners.place[c, 0], corners.place[c, 1], corners.place[c, 2] = corner_place(model, work, s, c)
        for k in range(3):
            contact_row(model, work, s, corners, c, k)
            whiten(model, work, corners, c, k, 3 * c + k)
            accelerations[c, k, 0] = turning(model, work, s, corners, c, k)
        accelerations[c, 0, 1] = falling(model, work, s, corners, c)
    return inverse_mass(model, work), common_velocity(model, work, s.xi_start, 0)


@pytest.mark.parametrize(("n_bodies", "rounding"), [(1, 0.0), (3, 0.0), (1, 0.004), (3, 0.004)])
@pytest.mark.parametrize("kind", [make_body, make_links])
def test_rows_are_velocities_and_give_the_delassus_matrix(kind, n_bodies: int, rounding: float) -> None:  # type: ignore[no-untyped-def]
    if kind is make_body and n_bodies > 1:
        assert make_body(make_system(random_tree(np.random.default_rng(0), n_bodies=n_bodies))) is None
        return
    rng = np.random.default_rng(n_bodies)
    model: ObjectModel = random_tree(rng, n_bodies=n_bodies)
    q, v = random_state(rng, model)
    system = make_system(model)._replace(law=np.array(Law(rounding=rounding)))
    nc, nx = system.n_corners, system.nv - 3
    given, s, corners = kind(system), make_state(system.nq, system.nv, 0), make_corners(nc, nx)
    s.q[:], s.v[:] = q, v
    model = model.with_changes(corner_pos=given.corner_pos)  # centres of spheres
    system, accelerations = make_system(model), np.zeros((nc, 3, 2))
    over_m, moved = rows(given, given.make_work(), s, corners, accelerations)
    assert over_m == pytest.approx(1 / model.mass.sum())
    u = v[:3] + s.R @ np.array(moved)

    def corners_at(h: float, a: np.ndarray = np.zeros(system.nv)) -> np.ndarray:
        mean = v + 0.5 * h * a
        turned = quat_mul(q[3:7], quat_exp(h * mean[3:6]))
        return corner_positions(model, np.r_[q[:3] + h * mean[:3], turned, q[7:] + h * mean[6:]])

    speed = (corners_at(1e-6) - corners_at(-1e-6)) / 2e-6
    for k, axis in enumerate((2, 0, 1)):  # normal, then x and y
        np.testing.assert_allclose(u[axis] + corners.tau[:, k] @ v[3:], speed[:, axis], atol=1e-7)
    free = np.r_[given.gravity - s.R @ s.a, s.rate]
    for i, a in enumerate((np.zeros(system.nv), free)):  # at constant velocities, and in free motion
        bent = (corners_at(1e-4, a) - 2 * corners_at(0.0) + corners_at(-1e-4, a)) / 1e-8
        for k, axis in enumerate((2, 0, 1) if i == 0 else (2,)):
            np.testing.assert_allclose(accelerations[:, k, i], bent[:, axis], atol=2e-5 * np.abs(bent).max())
    # A_ij = [same direction] / m + G_i . G_j against J M^-1 J^T
    work = tree.make_work(system)
    tree.kinematics(system, q, work)
    tree.mass_matrix(system, work)
    J, Jp = np.zeros((3 * nc, system.nv)), np.zeros((3, system.nv))
    for c in range(nc):
        b = system.corner_body[c]
        point = work.xpos[b] + work.xmat[b] @ system.corner_pos[c]
        tree.point_jacobian(system, work, b, point, Jp)
        J[3 * c : 3 * c + 3] = Jp[[2, 0, 1]]
    A = corners.G.T @ corners.G + over_m * np.kron(np.ones((nc, nc)), np.eye(3))
    expected = J @ np.linalg.solve(work.M, J.T)
    np.testing.assert_allclose(A, expected, atol=1e-9 * np.abs(expected).max())
