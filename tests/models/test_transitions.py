"""Which transitions are flight."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import DT, thrown
from tossid.models.transitions import make_transitions
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate
from tossid.types import Toss


def flights(model: ObjectModel, count: int, *, noise: float = 0.0) -> list[Toss]:
    """Tosses that come nowhere near the ground, with noise [m/s] of the base's velocity."""
    rng = np.random.default_rng(0)
    q, v = thrown(rng, count, model.n_joints)
    q[:, 2] += 1.0
    run = simulate(make_system(model), q, v, n_steps=30, dt=DT, substeps=16)
    zero, t = np.zeros((31, model.nv, model.nv)), np.arange(31) * DT
    run.v[..., :3] += noise * rng.normal(size=(count, 31, 3))
    return [Toss(str(i), t, run.q[i], run.v[i], zero, zero, np.zeros(31, np.uint8)) for i in range(count)]


@pytest.mark.parametrize("noise", [0.0, 2e-3])
def test_frames_in_the_hand_are_not_flight(cube: ObjectModel, noise: float) -> None:
    free = flights(cube, 8, noise=noise)
    assert len(make_transitions(cube, free).flight) == 8 * 30
    held = []
    for toss in free:
        v = toss.v.copy()
        v[1:, 2] += 9.81 * DT  # the first transition is at rest, as if in a hand
        held.append(Toss(toss.name, toss.t, toss.q, v, toss.q_cov, toss.v_cov, toss.phase))
    found = make_transitions(cube, held)
    assert len(found.flight) == 8 * 29
    fall = found.in_flight().dv[:, 2] / found.in_flight().dt
    assert float(fall.mean()) == pytest.approx(-9.81, abs=1e-6 + 30 * noise)


def test_links_that_swing_about_one_another_are_in_flight(elbow: ObjectModel) -> None:
    """The base's own acceleration is anything; that of the common centre of mass is gravity."""
    assert len(make_transitions(elbow, flights(elbow, 8)).flight) == 8 * 30
