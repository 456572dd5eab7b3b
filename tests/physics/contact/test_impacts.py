"""Steps that end at impacts: a dropped cube's impact, by the formulas of free fall."""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from tossid.kernels import kernel
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate
from tossid.physics.contact import impacts
from tossid.settings.contact import ContactSettings

HALF, G, DT = 0.0524, 9.81, 1 / 148


class Carried(NamedTuple):
    warm: np.ndarray
    span: np.ndarray
    carried: np.ndarray


@kernel(keep=False)
def scaled(corners, length, rigid):  # type: ignore[no-untyped-def]
    impacts.carry_over(corners, length, rigid)


@pytest.mark.parametrize(("length", "rigid", "expected"), [(0.005, True, 1.0), (0.005, False, 1.0), (0.04, False, 5.0)])
def test_impulses_keep_their_forces_in_a_step_of_another_length(length: float, rigid: bool, expected: float) -> None:
    """A corner that yields, loaded in one of many short parts: a whole step carries what all the parts did."""
    corners = Carried(np.array([[2.0, 0.4, -0.2], [0.0, 0.0, 0.0]]), np.array([0.01]), np.array([5.0, 0.0]))
    scaled(corners, length, rigid)
    assert corners.span[0] == length
    np.testing.assert_allclose(corners.warm, [[expected, 0.2 * expected, -0.1 * expected], [0, 0, 0]])


@pytest.mark.parametrize("height", [0.03, 0.1, 0.27])
def test_a_flat_drop_rebounds_from_where_it_touches(cube: ObjectModel, height: float) -> None:
    """Newton's restitution at the time of impact, v' = e sqrt(2 g z), wherever steps begin.

    A corner strikes from `touching_height`, 5e-5 m, above the ground: at 0.77 m/s and more, 6e-4 m/s or less too slow.
    """
    e = 0.5
    q = np.array([[0, 0, HALF + height, 1, 0, 0, 0.0]])
    system = make_system(cube.with_changes(restitution=e, friction=0.0))
    n = int(np.ceil(np.sqrt(2 * height / G) / DT)) + 2
    fall = SimpleNamespace(t=np.sqrt(2 * height / G), v=np.sqrt(2 * G * height))
    run = simulate(system, q, np.zeros((1, 6)), n_steps=n, dt=DT, impact_parts=8)
    after = n * DT - fall.t
    np.testing.assert_allclose(run.v[0, -1], [0, 0, e * fall.v - G * after, 0, 0, 0], atol=5e-4)
    np.testing.assert_allclose(run.q[0, -1, 2] - HALF, e * fall.v * after - 0.5 * G * after**2, atol=1e-4)
    assert run.lam_n.sum() == pytest.approx(cube.mass[0] * (1 + e) * fall.v, rel=1e-3)


def test_impacts_are_no_earlier_in_short_steps(cube: ObjectModel) -> None:
    """In steps of 26 µs a corner is within 50 µm of the ground for a step or two before it lands."""
    e, heights = 0.5, np.linspace(0.03, 0.05, 21)
    q = np.tile([0, 0, HALF, 1, 0, 0, 0.0], (21, 1))
    q[:, 2] += heights
    system = make_system(cube.with_changes(restitution=e, friction=0.0))
    run = simulate(system, q, np.zeros((21, 6)), n_steps=17, dt=DT, substeps=256, impact_parts=8)
    landing = np.sqrt(2 * G * heights)
    np.testing.assert_allclose(run.v[:, -1, 2], e * landing - G * (17 * DT - landing / G), atol=5e-5)


def test_heights_and_speeds_that_make_an_impact_are_the_callers(cube: ObjectModel) -> None:
    """From 0.04 mm at 0.3 m/s: struck there, or where it has come to the ground; a slow one is no impact."""
    height, speed = 4e-5, 0.3
    q, v0 = np.array([[0, 0, HALF + height, 1, 0, 0, 0.0]]), np.array([[0, 0, -speed, 0, 0, 0.0]])
    system = make_system(cube.with_changes(restitution=0.5, friction=0.0))
    landing = np.sqrt(speed**2 + 2 * G * height)
    fall = (landing - speed) / G
    expected = {5e-5: 0.5 * speed - G * DT, 1e-6: 0.5 * landing - G * (DT - fall)}
    for touching, after in expected.items():
        settings = ContactSettings(touching_height=touching)
        run = simulate(system, q, v0, n_steps=1, dt=DT, impact_parts=8, contact=settings)
        assert run.v[0, -1, 2] == pytest.approx(after, abs=2e-5)
    slow = simulate(system, q, v0, n_steps=1, dt=DT, impact_parts=8, contact=ContactSettings(impact_speed=5.0))
    assert abs(slow.v[0, -1, 2] - expected[1e-6]) > 0.01  # felt at the end of the step


def test_nothing_ends_a_step_that_has_no_impact(cube: ObjectModel) -> None:
    q = np.array([[0, 0, 1.0, 1, 0, 0, 0.0]])
    whole, cut = (
        simulate(make_system(cube), q, np.full((1, 6), 0.3), n_steps=20, dt=DT, impact_parts=parts) for parts in (1, 8)
    )
    np.testing.assert_array_equal(whole.q, cut.q)
