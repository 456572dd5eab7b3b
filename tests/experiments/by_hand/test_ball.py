"""Bounces made with known numbers come back with their drag, centre, rebound, radius of gyration and contact time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.by_hand.ball import fit_flight, jumps, medians, of_bounce, read_bounce
from experiments.by_hand.fits import with_interval

RADIUS, DT, GRAVITY, DRAG = 0.12, 1 / 360, 9.7, 0.02
REBOUND, SLIP_REBOUND, GYRATION, CONTACT = 0.8, 0.25, 0.6, 0.012
CENTRE = np.array([0.02, -0.03, 0.01])


def make_bounce(path: Path, rng: np.random.Generator, glitch: bool = False) -> None:
    """A bounce on a floor, with frames dropped and noise, tracked at a point beside the centre."""

    def fly(x: np.ndarray, v: np.ndarray, span: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times, places and velocities of flight from the floor, backwards where the span is negative."""
        h, steps = np.sign(span) * DT / 50, round(abs(span) / DT * 50)
        places, speeds = [x], [v]
        for _ in range(steps):
            a = -DRAG * np.linalg.norm(v) * v - np.array([0, 0, GRAVITY])
            x, v = x + h * v + 0.5 * h**2 * a, v + h * a
            places.append(x)
            speeds.append(v)
        return h * np.arange(steps + 1), np.array(places), np.array(speeds)

    v0, w0 = np.array([*rng.normal(0, 0.7, 2), -rng.uniform(4.5, 5.5)]), rng.normal(0, 7, 3)
    slip = v0[:2] + RADIUS * np.array([-w0[1], w0[0]])
    push = -(1 + SLIP_REBOUND) * slip / (1 + 1 / GYRATION)
    v1 = np.array([*(v0[:2] + push), -REBOUND * v0[2]])
    w1 = w0 + np.array([push[1], -push[0], 0]) / (GYRATION * RADIUS)
    floor = np.array([0, 0, RADIUS])
    t0, x0, _ = fly(floor, v0, -0.125)
    t1, x1, _ = fly(floor, v1, 0.3)
    s = np.arange(1, 200) / 200
    low = floor - np.outer(0.02 * np.sin(np.pi * s), [0, 0, 1])
    t = np.concatenate([t0[::-1], CONTACT * s, CONTACT + t1])
    x = np.concatenate([x0[::-1], low, x1])
    times = np.arange(-0.12, 0.3, DT) + rng.uniform(0, DT)
    times = times[rng.random(len(times)) > 0.4]
    turned = np.where(times[:, None] < CONTACT / 2, np.outer(times, w0), np.outer(times - CONTACT, w1))
    q = Rotation.from_rotvec(turned) * Rotation.from_rotvec(rng.normal(size=3))
    p = np.column_stack([np.interp(times, t, x[:, k]) for k in range(3)]) - q.apply(CENTRE)
    p += rng.normal(0, 1e-4, p.shape)
    q = Rotation.from_rotvec(rng.normal(0, 3e-4, p.shape)) * q
    if glitch:
        q = Rotation.from_rotvec(np.where(np.arange(len(times)) == 20, 2.0, 0.0)[:, None] * [1, 0, 0]) * q
    np.savetxt(path, np.column_stack([times - times[0], p, q.as_quat()]), fmt="%.9f")


def test_what_made_bounces_is_found_in_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(12):
        make_bounce(tmp_path / f"bounce_{k:02d}.txt", rng)
    bounces = [read_bounce(path, RADIUS) for path in sorted(tmp_path.glob("*.txt"))]
    assert not any(jumps(bounce) for bounce in bounces)
    flight = fit_flight(bounces)
    assert flight.gravity == pytest.approx(GRAVITY, abs=0.1)
    assert flight.drag == pytest.approx(DRAG, abs=0.006)
    assert flight.centre == pytest.approx(CENTRE, abs=2e-3)
    assert flight.residual == pytest.approx(1e-4, rel=0.3)
    assert flight.residual < 0.5 * fit_flight(bounces, offset=False).residual
    rows = with_interval([[of_bounce(bounce, flight, RADIUS)] for bounce in bounces], medians, 2000)
    assert rows["rebound"][0] == pytest.approx(REBOUND, abs=0.01)
    assert rows["tangential rebound"][0] == pytest.approx(SLIP_REBOUND, abs=0.04)
    assert rows["radius of gyration² over radius²"][0] == pytest.approx(GYRATION, abs=0.03)
    assert rows["time on the ground [ms]"][0] == pytest.approx(1e3 * CONTACT, abs=1)
    low, high = rows["rebound"][1:]
    assert low < rows["rebound"][0] < high < low + 0.03


def test_a_jump_of_the_tracker_leaves_a_bounce_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    make_bounce(tmp_path / "off.txt", rng, glitch=True)
    assert jumps(read_bounce(tmp_path / "off.txt", RADIUS))
