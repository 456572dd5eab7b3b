"""The simulator's parameters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.objects import ObjectModel
from tossid.physics import make_system

Array = NDArray[np.float64]


def test_plain_systems_carry_no_forces(cube: ObjectModel) -> None:
    system = make_system(cube)
    assert not system.forces.acts
    assert not system.law.acts


def test_a_system_has_the_object_s_numbers_but_for_those_that_are_given(cube: ObjectModel, elbow: ObjectModel) -> None:
    system = make_system(elbow, gravity=9.7, friction=0.3)
    assert (system.nq, system.nv, system.n_corners) == (elbow.nq, elbow.nv, elbow.n_corners)
    np.testing.assert_array_equal(system.gravity, [0.0, 0.0, -9.7])
    np.testing.assert_array_equal(system.mu, np.full(elbow.n_corners, 0.3))
    np.testing.assert_array_equal(make_system(cube, gravity=[0.1, 0.2, -9.5]).gravity, [0.1, 0.2, -9.5])
    np.testing.assert_array_equal(make_system(cube).mu, cube.friction)


def test_numbers_that_are_no_simulator_s_are_refused(cube: ObjectModel) -> None:
    with pytest.raises(ObjectError, match="gravity is"):
        make_system(cube, gravity=float("nan"))
    with pytest.raises(ObjectError, match=r"friction is -0\.1"):
        make_system(cube, friction=-0.1)
    with pytest.raises(ObjectError, match=r"restitution 0.2.*compliance 0.001"):
        make_system(cube.with_changes(restitution=0.2, compliance=1e-3))
