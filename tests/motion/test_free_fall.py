"""Centre of mass and gravity of bodies that fall."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.motion.free_fall import free_fall
from tossid.objects import unstated_object
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.types import Toss

COM = np.array([0.004, -0.011, 0.02])


def falling(rng: np.random.Generator, *, gravity: float = 9.81, spin: float = 6.0, noise: float = 5e-5) -> Toss:
    """A body whose centre of mass falls, turning about it."""
    t = np.arange(30) / 120
    turn = np.array([quat_exp(w) for w in t[:, None] * spin * rng.normal(size=3)])
    first = rng.normal(size=4)
    quat = quat_mul(np.broadcast_to(first / np.linalg.norm(first), turn.shape), turn)
    center = rng.normal(size=3) + t[:, None] * rng.normal(size=3) - 0.5 * gravity * t[:, None] ** 2 * [0, 0, 1]
    p = center - quat_to_matrix(quat) @ COM + noise * rng.normal(size=(30, 3))
    zero = np.zeros((30, 6, 6))
    return Toss("t", t, np.column_stack([p, quat]), np.zeros((30, 6)), zero, zero, np.zeros(30, dtype=np.uint8))


def high(toss: Toss) -> np.ndarray:
    return np.full(len(toss), 1.0)


def test_exact_flight_gives_exact_values() -> None:
    rng = np.random.default_rng(0)
    found = free_fall([falling(rng, gravity=3.7, noise=0.0) for _ in range(4)], unstated_object(), high)
    assert found.com == pytest.approx(COM[None], abs=1e-9)
    assert found.gravity == pytest.approx(3.7, abs=1e-8)
    assert found.stretches == 4


def test_the_truth_lies_within_three_standard_errors_of_noisy_flight() -> None:
    rng = np.random.default_rng(1)
    found = free_fall([falling(rng) for _ in range(30)], unstated_object(), high)
    assert (np.abs(found.com - COM) < 3 * found.com_deviation).all()
    assert abs(found.gravity - 9.81) < 3 * found.gravity_deviation
    assert (found.com_deviation < 2e-4).all()


def test_a_hand_in_one_stretch_does_not_pull_the_rest() -> None:
    rng = np.random.default_rng(2)
    tosses = [falling(rng) for _ in range(20)]
    held = tosses[0].q.copy()
    held[:, 0] += 0.3 * tosses[0].t ** 2
    held[10:, 2] += 0.02
    zero = np.zeros((30, 6, 6))
    tosses[0] = Toss("h", tosses[0].t, held, np.zeros((30, 6)), zero, zero, tosses[0].phase)
    assert free_fall(tosses, unstated_object(), high).com == pytest.approx(COM[None], abs=3e-4)


def test_frames_near_the_ground_are_no_flight() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(InputError, match="0 stretches of flight"):
        free_fall([falling(rng) for _ in range(4)], unstated_object(), lambda toss: np.zeros(len(toss)))


def test_a_body_that_does_not_turn_hides_its_centre_of_mass() -> None:
    rng = np.random.default_rng(4)
    with pytest.raises(InputError, match="hardly turns"):
        free_fall([falling(rng, spin=0.0, noise=0.0) for _ in range(4)], unstated_object(), high)
