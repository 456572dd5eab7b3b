"""ContactNets: its gradient in free parameters, and truth recovered from synthetic tosses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.models.made import flights, tosses
from tossid.models.contactnets import ContactNets
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.training.fit import Fit


@pytest.fixture(scope="module")
def transitions(cube: ObjectModel) -> Transitions:
    return make_transitions(cube, tosses(cube, 6, seed=0))


def test_gradient_by_the_envelope_theorem(cube: ObjectModel, transitions: Transitions) -> None:
    settings = ModelSettings(learn_inertia=True, learn_k_res=True, hidden=4)
    model = ContactNets(cube, settings, seed=1)
    rng = np.random.default_rng(0)
    plans = {plan.name: plan for plan in model.stages()}
    parameters = plans["inertia"].parameters + plans["continuous"].parameters
    with torch.no_grad():
        for p in parameters:
            p += 0.02 * torch.from_numpy(rng.normal(size=p.shape))
    gradients = torch.autograd.grad(model.loss(transitions)[0], parameters)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        direction = torch.from_numpy(rng.normal(size=parameter.shape))
        slopes = []
        for step in (1e-6, -1e-6):
            with torch.no_grad():
                parameter += step * direction
                slopes.append(float(model.loss(transitions)[0]))
                parameter -= step * direction
        slope = (slopes[0] - slopes[1]) / 2e-6
        assert float((gradient * direction).sum()) == pytest.approx(slope, rel=2e-3, abs=1e-6)


def test_geometry_and_friction_come_back(cube: ObjectModel) -> None:
    made = tosses(cube, 48, seed=3)
    start = cube.with_changes(corner_pos=1.2 * cube.corner_pos, friction=2 * cube.friction)
    model = ContactNets(start, ModelSettings(horizons=()))
    fit = Fit(model, made[:36], made[36:], TrainSettings(epochs=60, patience=10))
    records = list(fit.epochs())
    assert records[-1].validation_loss < records[0].validation_loss
    learned = model.learned_object()
    assert np.linalg.norm(learned.corner_pos - cube.corner_pos, axis=1).max() < 1e-3
    assert learned.friction == pytest.approx(cube.friction, abs=0.01)


def test_noise_of_velocities_is_not_taken_for_drag(cube: ObjectModel) -> None:
    """By the velocities that are in the differences, too, k_res found a drag of 0.29 / s."""
    free = flights(cube, 40)
    rng = np.random.default_rng(0)
    made = [replace(toss, v=toss.v + rng.normal(size=toss.v.shape) * np.repeat([0.06, 0.3], 3)) for toss in free]
    model = ContactNets(cube, ModelSettings(learn_k_res=True, horizons=(), implicit=False), seed=0)
    list(Fit(model, made[:30], made[30:]).epochs())
    q, v = np.concatenate([toss.q for toss in free]), np.concatenate([toss.v for toss in free])
    found = model.simulator().acceleration(q, v)[:, :3] + np.array([0, 0, 9.81])
    drag = -(found * v[:, :3]).sum() / (v[:, :3] ** 2).sum()
    assert abs(drag) < 0.02
