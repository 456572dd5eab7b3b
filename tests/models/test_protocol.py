"""A model as rigid bodies: its gravity, and what its learned acceleration adds beyond gravity."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import thrown
from tossid.models.predictor import Simulator
from tossid.models.protocol import Mechanics
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration

UP = slice(0, 3)
"""Features that are the world's vertical in the base's frame."""


def learned(
    nv: int, n_features: int, *, vertical: float, rng: np.random.Generator | None = None
) -> LearnedAcceleration:
    """A uniform vertical acceleration [m/s²], and a small network where `rng` is given."""
    linear = np.zeros((nv, n_features))
    linear[UP, UP] = vertical * np.eye(3)
    size = 0.0 if rng is None else 0.3
    draw = rng or np.random.default_rng(0)
    W0, b0, W1, b1, W2 = (size * draw.normal(size=shape) for shape in ((4, n_features), (4,), (4, 4), (4,), (nv, 4)))
    return LearnedAcceleration(linear, W0, b0, W1, b1, W2)


@pytest.fixture
def n_features() -> int:
    return 3 + 6


def test_a_model_that_was_given_no_gravity_carries_what_it_learned(cube: ObjectModel, n_features: int) -> None:
    whole = Mechanics(cube, 0.0, learned(6, n_features, vertical=-9.7), vertical=-9.7)
    assert whole.carried_gravity == pytest.approx(9.7)
    q, v = thrown(np.random.default_rng(0), 4)
    found = Simulator(whole.system()).acceleration(q, 0 * v)
    np.testing.assert_allclose(found, np.tile([0, 0, -9.7, 0, 0, 0], (4, 1)), atol=1e-12)


def test_without_its_vertical_part_only_the_rest_is_left(cube: ObjectModel, n_features: int) -> None:
    rng = np.random.default_rng(1)
    features = rng.normal(size=(5, n_features))
    plain = Mechanics(cube, 0.0, learned(6, n_features, vertical=-9.7), vertical=-9.7)
    np.testing.assert_allclose(plain.k_res_without_vertical(features), 0.0, atol=1e-12)
    net = learned(6, n_features, vertical=-9.7, rng=rng)
    hidden = np.tanh(net.W1 @ np.tanh(net.W0 @ features[2] + net.b0) + net.b1)
    found = Mechanics(cube, 0.0, net, vertical=-9.7).k_res_without_vertical(features)
    np.testing.assert_allclose(found[2], net.W2 @ hidden, atol=1e-12)


def test_without_a_learned_acceleration_there_is_nothing_to_add(cube: ObjectModel, n_features: int) -> None:
    assert not Mechanics(cube, 9.81).k_res_without_vertical(np.ones((3, n_features))).any()
    assert Mechanics(cube, 9.81).carried_gravity == 9.81
