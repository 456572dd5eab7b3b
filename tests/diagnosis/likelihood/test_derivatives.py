"""Derivatives by effects' parameters predict how residuals change, and are taken once where they hold."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.derivatives import Derivatives, derivatives, effect_derivatives
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_derivatives_predict_how_residuals_change(of_flight: tuple[Evidence, Hypothesis]) -> None:
    evidence, hypothesis = of_flight
    residuals = evidence.residuals(hypothesis.world())
    J = derivatives(evidence, hypothesis, residuals, sizes=np.ones(1))
    moved = hypothesis.at(hypothesis.flat() + 0.05)
    change = evidence.residuals(moved.world()) - residuals
    np.testing.assert_allclose(J[..., 0] * 0.05 / hypothesis.steps[0], change, atol=1e-3 * np.abs(change).max())


def test_derivatives_are_taken_anew_only_where_predictions_have_moved(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 8, seed=2)
    evidence = Evidence(*linearise(make_windows(tosses, cube), World(cube), refine=3))
    start = Hypothesis(World(cube)).plus(EFFECTS["friction"]).plus(EFFECTS["gravity"])
    sizes, which = np.full(2, 8.0), [0, 1]

    def fresh(at: Hypothesis, sizes: np.ndarray) -> Derivatives:
        values = derivatives(evidence, at, evidence.residuals(at.world()), which, sizes)
        return Derivatives(values, evidence.predicted(at.world()), sizes)

    first = fresh(start, sizes)
    same = first.renewed(evidence, start, evidence.residuals(start.world()), which, 1.5 * sizes)
    np.testing.assert_array_equal(same.values, first.values)
    np.testing.assert_array_equal(same.sizes, sizes)

    moved = start.at(start.flat() + np.array([0.05, 0.0]))
    expected, found = (
        fresh(moved, sizes),
        first.renewed(evidence, moved, evidence.residuals(moved.world()), which, sizes),
    )
    felt = (found.values != first.values).any((1, 2, 3))
    assert 0 < felt.sum() < len(felt)
    assert not felt[evidence.windows.free].any()
    np.testing.assert_allclose(found.values[felt], expected.values[felt], atol=1e-9)

    other = np.array([8.0, 1.0])
    narrow = first.renewed(evidence, start, evidence.residuals(start.world()), which, other)
    np.testing.assert_array_equal(narrow.values[..., 0], first.values[..., 0])
    np.testing.assert_allclose(narrow.values[..., 1], fresh(start, other).values[..., 1], atol=1e-9)


@pytest.mark.parametrize("name", ["friction", "gravity", "compliance"])
def test_derivatives_by_an_effect_are_kept_beside_each_world(cube: ObjectModel, name: str) -> None:
    evidence = Evidence(*linearise(make_windows(seen(World(cube), cube, 4, seed=2), cube), World(cube)))
    nothing, effect = Hypothesis(World(cube)), EFFECTS[name]
    residuals = evidence.residuals(nothing.world())
    with_it, own, J = effect_derivatives(evidence, nothing, effect, residuals)
    assert own == list(range(len(effect.parameters)))
    # compliance has no value at which it does nothing, so its derivatives start from its nominal world
    begin = evidence.residuals(with_it.world())
    np.testing.assert_array_equal(J, derivatives(evidence, with_it, begin))
    assert effect_derivatives(evidence, nothing, effect, residuals)[2] is J
    other = nothing.plus(EFFECTS["torsional_friction"], np.array([5e-3]))
    beside = effect_derivatives(evidence, other, effect, evidence.residuals(other.world()))
    assert beside[1] == list(range(1, 1 + len(effect.parameters)))
    assert beside[2] is not J
