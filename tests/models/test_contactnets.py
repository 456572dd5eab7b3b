"""The implicit loss: its gradient against finite differences, and truth recovered from synthetic tosses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tossid.models.contactnets import ContactNets, ContactNetsSettings
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel, load_object
from tossid.physics import make_system, simulate
from tossid.training.fit import Fit, FitSettings
from tossid.types import Toss

DT = 1 / 148


@pytest.fixture(scope="module")
def cube() -> ObjectModel:
    return load_object(Path(__file__).parents[2] / "conf/object/cube.xml")


def tosses(model: ObjectModel, count: int, *, seed: int, frames: int = 70) -> list[Toss]:
    """Tosses by the LCP engine, without noise."""
    rng = np.random.default_rng(seed)
    q = np.zeros((count, 7))
    q[:, 2] = rng.uniform(0.12, 0.3, count)
    q[:, 3:] = rng.normal(size=(count, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    v = np.concatenate([rng.normal(size=(count, 3)), 4 * rng.normal(size=(count, 3))], axis=1)
    run = simulate(make_system(model), q, v, n_steps=frames, dt=DT)
    zero, phase = np.zeros((frames + 1, 6, 6)), np.zeros(frames + 1, dtype=np.uint8)
    t = np.arange(frames + 1) * DT
    return [Toss(str(i), t, run.q[i], run.v[i], zero, zero, phase) for i in range(count)]


@pytest.fixture(scope="module")
def transitions(cube: ObjectModel) -> Transitions:
    return make_transitions(cube, tosses(cube, 6, seed=0))


def test_the_loss_is_almost_zero_at_the_truth(cube: ObjectModel, transitions: Transitions) -> None:
    loss, parts = ContactNets(cube, ContactNetsSettings()).loss(transitions)
    wrong, _ = ContactNets(cube.with_changes(friction=0.36), ContactNetsSettings()).loss(transitions)
    assert parts["unsolved"] == 0
    assert float(loss.detach()) < 0.5 * float(wrong.detach())


def test_gradient_by_the_envelope_theorem(cube: ObjectModel, transitions: Transitions) -> None:
    settings = ContactNetsSettings(learn_inertia=True, learn_residual=True, hidden=4)
    model = ContactNets(cube, settings, seed=1)
    rng = np.random.default_rng(0)
    parameters = [p for p in model.parameters() if p.requires_grad]
    with torch.no_grad():
        for p in parameters:
            p += 0.02 * torch.from_numpy(rng.normal(size=p.shape))
    gradients = torch.autograd.grad(model.loss(transitions)[0], parameters, allow_unused=True)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        assert gradient is not None
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
    made = tosses(cube, 64, seed=3)
    start = cube.with_changes(corner_pos=1.2 * cube.corner_pos, friction=2 * cube.friction)
    model = ContactNets(start, ContactNetsSettings())
    fit = Fit(
        model,
        make_transitions(start, made[:48]),
        make_transitions(start, made[48:]),
        FitSettings(epochs=60, patience=10),
    )
    records = list(fit.epochs())
    assert records[-1].validation_loss < records[0].validation_loss
    learned = model.learned_object()
    assert np.linalg.norm(learned.corner_pos - cube.corner_pos, axis=1).max() < 1e-3
    assert learned.friction == pytest.approx(cube.friction, abs=0.01)


def test_a_fit_goes_on_where_it_was(cube: ObjectModel, transitions: Transitions) -> None:
    def fresh() -> Fit:
        model = ContactNets(cube.with_changes(friction=0.3), ContactNetsSettings())
        return Fit(model, transitions, transitions, FitSettings(epochs=6))

    whole = fresh()
    list(whole.epochs())
    first = fresh()
    steps = first.epochs()
    for _ in range(3):
        next(steps)
    second = fresh()
    second.load_state_dict(first.state_dict())
    list(second.epochs())
    for a, b in zip(whole.model.parameters(), second.model.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_missing_gravity_is_repaired_from_flight(cube: ObjectModel) -> None:
    data = make_transitions(cube, tosses(cube, 8, seed=5))
    model = ContactNets(cube, ContactNetsSettings(gravity=0.0, learn_residual=True), seed=0)
    list(Fit(model, data, data, FitSettings(epochs=25)).epochs())
    assert model.residual is not None
    falls = model.residual(data.in_flight().features).detach().numpy()
    R = data.in_flight().R[:, 0].numpy()
    vertical = np.einsum("ni,ni->n", R[:, 2], falls[:, :3])
    assert vertical.mean() == pytest.approx(-9.81, rel=0.02)
