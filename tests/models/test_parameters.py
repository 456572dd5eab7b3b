"""What a model can learn: its start is the object, and its numbers mean what they say."""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np
import pytest
import torch

from tossid.models.parameters import (
    COHESION,
    CONTACT_TIMES_MS,
    DAMPINGS,
    SIMULATOR_STEP_MS,
    ContactLaw,
    Friction,
    LearnedAccelerationNet,
)
from tossid.models.predictor import Simulator
from tossid.models.protocol import Mechanics
from tossid.objects import GRAVITY, ObjectModel
from tossid.physics import learned_accelerations, make_system, n_features, tree_batch
from tossid.rotations import quat_to_matrix


def test_the_contact_law_is_its_time_damping_and_cohesion(cube: ObjectModel) -> None:
    given = cube.with_changes(compliance=1e-5, relaxation=2e-3, cohesion=0.1)
    assert ContactLaw(given, learn=False)() == (1e-5, 2e-3, 0.1)
    law = ContactLaw(cube, learn=True)
    with torch.no_grad():
        law.value.copy_(torch.tensor([log(2.0), log(0.5), 0.1]))
    mass = float(cube.mass.sum())
    expected = ((2e-3) ** 2 / mass, 0.5 * 2e-3, 0.01 * mass * GRAVITY)
    np.testing.assert_allclose(law(), expected, rtol=1e-6)
    with torch.no_grad():
        law.value[2] = -0.2  # as differences beside none may leave it
    assert law()[2] == 0.0
    assert float(law.soft_starts()[-1][2]) == COHESION
    with torch.no_grad():
        law.value[2] = 0.2
    assert float(law.soft_starts()[-1][2]) == pytest.approx(0.2)
    law.move(law.rigid())
    assert not law.yields
    starts = law.soft_starts()
    time, damping, cohesion = starts[-1].tolist()
    assert cohesion == COHESION
    assert exp(time) == pytest.approx(CONTACT_TIMES_MS[-1])
    slow = DAMPINGS[-1] * CONTACT_TIMES_MS[-1]
    assert exp(damping) == pytest.approx(sqrt(slow**2 + 2 * SIMULATOR_STEP_MS * slow) / CONTACT_TIMES_MS[-1])
    assert all(float(law.rigid()[0]) < float(start[0]) for start in starts)


def test_mechanics_separate_the_uniform_vertical_part(elbow: ObjectModel) -> None:
    net = LearnedAccelerationNet(1, hidden=5, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        net.vertical -= 0.3
        net.W2 += 0.1
    features = np.random.default_rng(1).normal(size=(4, n_features(1)))
    mechanics = Mechanics(elbow, 5.0, net.arrays(), 10 * float(net.vertical.detach()))
    assert mechanics.carried_gravity == pytest.approx(8.0)
    rest = net.without_vertical(torch.from_numpy(features)).detach().numpy()
    np.testing.assert_allclose(mechanics.k_res_without_vertical(features), rest, atol=1e-12)
    assert not Mechanics(elbow, 5.0).k_res_without_vertical(features).any()
    assert Mechanics(elbow, 5.0).carried_gravity == 5.0
    q = np.array([[0.0, 0, 0.3, 0.8, 0.6, 0, 0, 0.1]])
    flat = LearnedAccelerationNet(1, hidden=5, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        flat.vertical -= 0.97
    carried = Mechanics(elbow, 0.0, flat.arrays(), flat.uniform_vertical())
    assert carried.carried_gravity == pytest.approx(9.7)
    fall = Simulator(carried.system()).acceleration(q, np.zeros((1, 7)))
    np.testing.assert_allclose(fall[0, :3], [0, 0, -9.7], atol=1e-9)


@pytest.mark.parametrize("world", [False, True])
@pytest.mark.parametrize("joints", [0, 1])
def test_k_res_is_the_same_in_torch_and_in_the_simulator(
    cube: ObjectModel, elbow: ObjectModel, joints: int, world: bool
) -> None:
    model, rng = (cube, elbow)[joints], np.random.default_rng(0)
    generator = torch.Generator().manual_seed(0)
    net = LearnedAccelerationNet(joints, hidden=5, generator=generator, world=world, gravity=not world)
    with torch.no_grad():
        for parameter in net.parameters():
            if parameter.requires_grad:
                parameter += 0.1 * torch.from_numpy(rng.normal(size=tuple(parameter.shape)))
    q, v = rng.normal(size=(7, model.nq)), rng.normal(size=(7, model.nv))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    features = tree_batch(make_system(model), q, v).features
    found = net(torch.from_numpy(features)).detach().numpy()
    np.testing.assert_allclose(found, learned_accelerations(net.arrays(), features, model.nv), rtol=1e-9)
    with_it, without = (Simulator(make_system(model, k_res=k)).acceleration(q, v) for k in (net.arrays(), None))
    linear = np.einsum("nij,nj->ni", quat_to_matrix(q[:, 3:7]), found[:, :3])
    np.testing.assert_allclose(with_it - without, np.hstack([linear, found[:, 3:]]), rtol=1e-7, atol=1e-9)


def test_a_k_res_without_a_gravity_of_its_own_has_it_in_its_linear_part() -> None:
    generator = torch.Generator().manual_seed(0)
    body = LearnedAccelerationNet(0, hidden=4, generator=generator, gravity=False)
    world = LearnedAccelerationNet(0, hidden=4, generator=generator, world=True, gravity=False)
    with torch.no_grad():
        body.linear[:3, :3] -= 0.5 * torch.eye(3)
        world.linear_world[2, 0] -= 0.5
    assert not body.vertical.requires_grad
    assert body.uniform_vertical() == world.uniform_vertical() == pytest.approx(-5.0)
    features = torch.zeros(1, n_features(0, world=True), dtype=torch.float64)
    features[0, 2] = features[0, n_features(0)] = features[0, n_features(0) + 4] = features[0, n_features(0) + 6] = 1.0
    for net in (body, world):
        np.testing.assert_allclose(net(features).detach().numpy()[0, :3], [0.0, 0.0, -5.0], atol=1e-12)


def test_a_friction_stated_as_none_is_kept_or_can_be_learned(cube: ObjectModel) -> None:
    smooth = cube.with_changes(friction=0.0)
    assert float(Friction(smooth, learn=False)()) == 0.0
    friction = Friction(smooth, learn=True)
    friction().backward()
    assert float(friction().detach()) == pytest.approx(0.01)
    assert float(friction.log_mu.grad) > 0
