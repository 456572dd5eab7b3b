"""The tree as the time stepper's model: one body is the single body, impacts depend on no grid of steps."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.test_body import falling
from tests.physics.trees import EVERYTHING
from tossid.objects import ObjectModel
from tossid.physics import Simulation, make_system, simulate, stepping
from tossid.physics.effects import Forces, Law, World
from tossid.physics.links import make_links

DT = 1 / 148


CONTACTS = {
    "speed and direction in friction": Law(static_rel=1.8, slip_speed=0.3, y_rel=0.6),
    "resistance to spin": Law(torsional=0.02, rolling=0.004),
    "adhesion": Law(adhesion=0.8),
    "rounded": Law(rounding=0.006),
    "relaxed": Law(lifting=1e-3),
    "held at once": Law(added_mass=3.0),
}


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("what", ["forces", "bouncing", "soft", *CONTACTS])
def test_a_tree_of_one_body_is_that_body(
    cube: ObjectModel, what: str, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    odd = cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=cube.inertia * np.diag([1.0, 1.2, 0.9]))
    if what == "bouncing":
        odd = odd.with_changes(restitution=0.4)
    if what in ("soft", "held at once"):
        odd = odd.with_changes(compliance=3e-5, relaxation=2e-3)
    forces = EVERYTHING._replace(spin=0.0, magnus=0.0) if what == "forces" else Forces()
    system = World(odd, forces=forces, law=CONTACTS.get(what, Law())).system()
    q, v = falling(np.random.default_rng(1), 30, lowest=0.1)
    runs: list[Simulation] = []
    for _ in range(2):
        runs.append(simulate(system, q, v, n_steps=12, dt=DT, substeps=2, impact_parts=parts, tolerance=1e-11))
        monkeypatch.setattr(stepping, "_model_of", lambda same: make_links(same.system))
    body, linked = runs
    assert (body.lam_n > 0).any(axis=(1, 2)).mean() > 0.6
    apart = np.abs(body.q - linked.q).max(axis=(1, 2))
    # rounding may decide whether a step has an impact
    assert np.median(apart) < (1e-9 if parts == 1 or what == "soft" else 3e-4)
    assert (apart < (1e-6 if parts == 1 or what == "soft" else 1e-3)).mean() > 0.9


def test_what_an_impact_of_a_tree_does_hangs_on_no_grid_of_steps(elbow: ObjectModel) -> None:
    """As for a single body (test_body): with whole steps the motion sways as often as the impact crosses a step."""
    heights = np.linspace(0.0, 5e-3, 61)
    q, v = np.zeros((61, 8)), np.zeros((61, 7))
    q[:, 3:7] = np.array([0.85, 0.35, 0.25, 0.3]) / np.linalg.norm([0.85, 0.35, 0.25, 0.3])
    q[:, 2], q[:, 7], v[:] = 0.09 + heights, 0.7, [0.7, 0.2, -1.2, 3.0, -5.0, 2.0, 3.0]

    def sways(parts: int) -> float:
        run = simulate(make_system(elbow), q, v, n_steps=14, dt=DT, substeps=8, impact_parts=parts)
        assert (run.lam_n > 0).any(axis=(1, 2)).all()
        x = run.q[:, -1, :3]
        curve = np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, 61), 3)
        return float(np.linalg.norm(x - curve @ (np.linalg.pinv(curve) @ x), axis=1).mean())

    assert sways(8) < 0.3 * sways(1)
