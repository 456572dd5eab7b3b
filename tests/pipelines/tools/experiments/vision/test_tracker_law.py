"""What flights are made with comes back from the fit, with an interval that holds it."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.vision.tracker_law import MODELS, Flights, fit_flights, flight_effects
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.forces import Forces
from tossid.rotations import quat_exp, quat_to_matrix

DT, FRAMES, NOISE = 1 / 148, 16, 2e-5
COM = np.array([1e-3, -2e-3, 5e-3])
GRAVITY, DRAG, TILT = 9.65, 0.04, np.array([-0.03, 0.09])


def made(*, turning: float = 0.0, tilt: np.ndarray = TILT) -> Flights:
    """Flights of a body whose recorded frame is off its centre of mass, thrown along x and then turned by recording."""
    rng, flights = np.random.default_rng(4), Flights([], [], [], np.zeros(0), np.zeros(0, np.int64))
    yaw, recording = [], []
    for i in range(240):
        if i % 4 == 0:
            angle = rng.uniform(-np.pi, np.pi)
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        x, v = np.array([-0.25, 0.0, 0.15]), np.array([1.1, 0.0, -0.1]) + rng.normal(0, 0.15, 3)
        at, fine = [], 20
        for _ in range(FRAMES):
            at.append(x.copy())
            for _ in range(fine):
                a = np.array([*tilt, -GRAVITY]) - DRAG * np.linalg.norm(v) * v + turning * np.array([-v[1], v[0], 0.0])
                x, v = x + DT / fine * v + 0.5 * (DT / fine) ** 2 * a, v + DT / fine * a
        t = DT * np.arange(FRAMES)
        start = quat_to_matrix(quat_exp(rng.normal(0, 2, 3)))
        R = quat_to_matrix(quat_exp(rng.normal(0, 5, 3) * t[:, None])) @ start
        flights.t.append(np.asarray(t, dtype=np.float64))
        flights.p.append(np.array(at) @ turn.T + R @ COM + rng.normal(0, NOISE, (FRAMES, 3)))
        flights.R.append(R)
        yaw.append(angle)
        recording.append(i // 4)
    return Flights(flights.t, flights.p, flights.R, np.array(yaw), np.array(recording))


def test_drag_tilt_and_centre_of_mass_come_back() -> None:
    fit = fit_flights(made(), MODELS["drag, tilt in the throw"], draws=200)
    true = dict(zip(("com x", "com y", "com z"), COM, strict=True))
    true |= {"gz": -GRAVITY, "drag": DRAG, "g along": TILT[0], "g left": TILT[1]}
    for term, value in true.items():
        low, high = fit.interval(term)
        assert abs(fit[term] - value) < 1.2 * (high - low), term
    low, high = fit.interval("g left")
    assert high - low < 0.02
    assert 1e3 * fit.rms == pytest.approx(1e3 * NOISE, rel=0.1)
    assert 1e3 * fit.robust == pytest.approx(1e3 * NOISE, rel=0.1)


def test_a_turned_tilt_looks_like_a_turning_frame_and_a_turning_frame_is_none() -> None:
    turned = made(tilt=np.array([0.0, 0.13]))
    law = fit_flights(turned, MODELS["drag, turning"], draws=50)
    assert law["J"] == pytest.approx(0.13 / 1.1, rel=0.15)
    both = fit_flights(turned, MODELS["drag, tilt, turning"], draws=200)
    low, high = both.interval("J")
    assert low < 0 < high
    turning = fit_flights(made(turning=0.12, tilt=np.zeros(2)), MODELS["drag, tilt, turning"], draws=200)
    low, high = turning.interval("J")
    assert low < 0.12 < high
    assert low > 0.02


def test_effects_of_flight_are_selected(cube: ObjectModel) -> None:
    tosses = seen(World(cube, forces=Forces(turning=0.6)), cube, 16, seed=5)
    found = flight_effects(tosses, cube)
    assert set(found) == {"turning_frame"}
    assert found["turning_frame"][0] == pytest.approx(0.6, abs=0.1)
    assert flight_effects(seen(World(cube), cube, 16, seed=6), cube) == {}
