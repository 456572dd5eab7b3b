"""Drops made by the laws of one impact come back with their gravity, drag, rebound, friction and radius of gyration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipelines.tools.experiments.by_hand.die import (
    by_drop,
    corners,
    impacts,
    of_flight,
    of_impacts,
    pieces,
    read_drop,
    scatter_of_impacts,
)
from pipelines.tools.experiments.by_hand.fits import with_interval

HALF, DT, GRAVITY, DRAG = 0.03, 0.004, 9.7, 0.4
REBOUND, FRICTION, GYRATION = 0.45, 0.1, 550e-6


def make_drop(path: Path, rng: np.random.Generator) -> None:
    """A drop with one impact of a lone corner that keeps slipping, as a TUM file with noise."""
    angle = np.deg2rad(rng.uniform(25, 40) * rng.choice([-1.0, 1.0]))
    state = np.array([0.0, 0.14, angle, rng.uniform(0.6, 0.9), -rng.uniform(1.5, 2.0), rng.uniform(-3, 3)])
    steps, h, poses, hit = 40, DT / 40, [], False
    for _ in range(70):
        poses.append(state[:3].copy())
        for _ in range(steps):
            accelerate = -DRAG * state[3:] - np.array([0.0, GRAVITY, 0.0])
            state = np.concatenate([state[:3] + h * state[3:] + 0.5 * h**2 * accelerate, state[3:] + h * accelerate])
            r = corners(state[2], HALF)
            arm = r[np.argmin(r[:, 1])]
            if not hit and state[1] + arm[1] < 0:
                hit, across = True, np.array([arm[1], -arm[0]])
                slip, closing = state[3:5] + state[5] * across
                pull = np.array([-FRICTION * np.sign(slip), 1.0])
                # one unit of normal impulse a mass changes the corner's normal velocity by this
                turn = (arm[1] * pull[0] - arm[0] * pull[1]) / GYRATION
                normal = -(1 + REBOUND) * closing / (1.0 - turn * arm[0])
                state[3:5] += normal * pull
                state[5] += normal * turn
    x, z, a = np.array(poses).T + rng.normal(size=(3, 70)) * np.array([[1e-5], [2e-5], [3e-4]])
    q = np.column_stack([0 * a, np.sin(a / 2), 0 * a, np.cos(a / 2)])
    np.savetxt(path, np.column_stack([DT * np.arange(70), x, 0 * x, z, q]), fmt="%.9f")


def test_what_made_drops_is_found_in_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(30):
        make_drop(tmp_path / f"drop_{k:02d}.txt", rng)
    drops = [read_drop(path) for path in sorted(tmp_path.glob("*.txt"))]
    flying = [p for drop in drops for p in pieces(drop, HALF) if abs(p.a[1] + 9.81) < 4]
    flight = of_flight(flying)
    assert flight["gravity [m/s²]"] == pytest.approx(GRAVITY, abs=0.05)
    assert flight["drag, z [1/s]"] == pytest.approx(DRAG, abs=0.06)
    assert flight["drag, spin [1/s]"] == pytest.approx(DRAG, abs=0.1)
    hits = [hit for drop in drops for hit in impacts(drop, HALF, DRAG)]
    assert len(hits) > 10
    found = with_interval(by_drop(hits), of_impacts, resamples=50)
    assert found["rebound"][0] == pytest.approx(REBOUND, abs=0.02)
    assert found["sliding friction"][0] == pytest.approx(FRICTION, abs=0.01)
    assert found["radius of gyration² [mm²]"][0] == pytest.approx(1e6 * GYRATION, rel=0.05)
    assert abs(found["angle leads height [ms]"][0]) < 0.5
    for value, low, high in found.values():
        assert low <= value <= high
    scatter = scatter_of_impacts(hits)
    assert np.ptp(scatter["rebound"][[1, 3]]) < 0.02
    assert np.abs(scatter["change of spin less that of its impulse [rad/s]"]).max() < 1.0
    assert np.ptp(scatter["angle leads height [ms]"][[1, 3]]) < 0.5
