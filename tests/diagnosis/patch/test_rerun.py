"""The patched model, run in MuJoCo on tosses of its own truth, closes the gap."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import hypothesis
from tossid.diagnosis.patch.make import make_patch
from tossid.diagnosis.patch.rerun import rerun
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.types import Phase, Toss

HALF = 0.0524
"""Half the width of the cube [m]."""


def mujoco_tosses(model: ObjectModel, friction: float, n: int = 8) -> list[Toss]:
    """Tosses by MuJoCo at the near rigid setting of the scene that patches are made in."""
    rng = np.random.default_rng(5)
    q0, v0 = np.zeros((n, 7)), np.zeros((n, 6))
    q0[:, 3:] = rng.normal(size=(n, 4))
    q0[:, 3:] /= np.linalg.norm(q0[:, 3:], axis=1, keepdims=True)
    q0[:, 2] = 0.2
    v0[:, :3], v0[:, 3:] = rng.normal(size=(n, 3)) * 0.7, rng.normal(size=(n, 3)) * 3
    q, v = toss_in_mujoco(World(model.with_changes(friction=friction)), q0, v0, 70, 1 / 148, substeps=68)
    cov = np.diag([1.5e-4**2] * 3 + [1.5e-3**2] * 3)
    cov = np.broadcast_to(cov, (71, 6, 6)).copy()
    phase = np.full(71, int(Phase.UNKNOWN), dtype=np.uint8)
    return [Toss(str(i), np.arange(71) / 148, q[i], v[i], cov, cov, phase) for i in range(n)]


def test_the_right_patch_closes_the_gap_in_mujoco(cube: ObjectModel) -> None:
    tosses = mujoco_tosses(cube, 0.4)
    found = hypothesis(cube, friction=[0.4])
    run = rerun(make_patch(found), found, tosses, cube)
    assert run["position_error_pct"]["after"]["value"] < 0.5 < run["position_error_pct"]["before"]["value"]
    assert run["gap"]["after"]["value"] < 0.5 * run["gap"]["before"]["value"]
    assert run["gap_closed"]["value"] > 0.5
    assert run["lost"] == {"before": 0, "after": 0}


def test_a_first_state_below_the_ground_is_not_thrown_up(cube: ObjectModel) -> None:
    """A cube that slides 2 mm deep: a stiff, bouncing contact would make it jump."""
    sunk = []
    for toss in mujoco_tosses(cube, 0.18, n=6):
        q, v = toss.q.copy(), np.zeros((71, 6))
        v[:, 0] = np.maximum(0.9 - 0.18 * 9.81 * toss.t, 0)
        q[:, 0], q[:, 1] = np.cumsum(v[:, 0]) / 148, 0
        q[:, 2], q[:, 3:] = HALF - 2e-3, [1, 0, 0, 0]
        sunk.append(Toss(toss.name, toss.t, q, v, toss.q_cov, toss.v_cov, toss.phase))
    found = hypothesis(cube, restitution=[0.4])
    run = rerun(make_patch(found), found, sunk, cube)
    assert run["gap"]["after"]["value"] < 6
