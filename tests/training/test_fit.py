"""The fit: exact resumption in every stage, and inertia and restitution recovered from rollouts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.models.made import tosses
from tossid.models.contactnets import ContactNets, ContactNetsSettings
from tossid.models.predictor import SUBSTEPS
from tossid.objects import ObjectModel
from tossid.training.fit import Fit, FitSettings

COM = np.array([[1e-3, -2e-3, 6e-3]])


@pytest.mark.parametrize(("optimizer", "stop"), [("lbfgs", 2), ("lbfgs", 5), ("lbfgs", 7), ("adam", 5)])
def test_it_goes_on_where_it_was(cube: ObjectModel, optimizer: str, stop: int) -> None:
    made = tosses(cube.with_changes(com=COM), 6, seed=0)

    def fresh() -> Fit:
        settings = ContactNetsSettings(learn_inertia=True, learn_residual=True, hidden=4)
        model = ContactNets(cube.with_changes(friction=0.3), settings)
        return Fit(model, made[:4], made[4:], FitSettings(epochs=3, optimizer=optimizer, horizons=(10, 20)))

    whole = fresh()
    count = len(list(whole.epochs()))
    assert count > stop
    first = fresh()
    steps = first.epochs()
    for _ in range(stop):
        next(steps)
    second = fresh()
    second.load_state_dict(first.state_dict())
    assert len(list(second.epochs())) == count - stop
    for a, b in zip(whole.model.parameters(), second.model.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_inertia_and_restitution_come_back_from_rollouts(cube: ObjectModel) -> None:
    truth = cube.with_changes(com=COM, inertia=1.4 * cube.inertia, restitution=0.25)
    made = tosses(truth, 40, seed=3, substeps=SUBSTEPS)
    settings = ContactNetsSettings(learn_geometry=False, learn_inertia=True, implicit=False)
    model = ContactNets(cube.with_changes(friction=0.25), settings)
    list(Fit(model, made[:30], made[30:]).epochs())
    learned = model.learned_object()
    assert learned.friction == pytest.approx(truth.friction, rel=0.02)
    assert learned.restitution == pytest.approx(0.25, abs=0.01)
    assert np.abs(learned.com - COM).max() < 3e-4
    np.testing.assert_allclose(learned.inertia[0], truth.inertia[0], atol=0.04 * truth.inertia[0, 0, 0])
    report = model.parameters_report()
    assert report["restitution"] == learned.restitution
