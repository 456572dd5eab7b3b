"""Fits find the parameters that tosses were made with, with intervals that are right."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.derivatives import derivatives
from tossid.diagnosis.likelihood.evidence import FREE, Evidence, Hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted, fit, toss_sums
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.mark.parametrize(
    ("name", "truth", "tolerance"),
    [
        ("friction", [0.25], 0.004),
        ("com_offset", [2e-3, -3e-3, 5e-3], 8e-4),
        ("gravity", [9.3], 0.06),
        ("length_scale", [0.98], 2e-3),
    ],
)
def test_parameters_come_back(cube: ObjectModel, name: str, truth: list[float], tolerance: float) -> None:
    nominal = World(cube)
    effect = EFFECTS[name]
    tosses = seen(effect.at(nominal, np.array(truth)), cube, 16, seed=1)
    hypothesis, windows = Hypothesis(nominal).plus(effect), make_windows(tosses)
    evidence = Evidence(*linearise(windows, hypothesis.world(), refine=3))
    fitted = fit(evidence, hypothesis, n_tosses=len(tosses), iterations=12)
    np.testing.assert_allclose(fitted.hypothesis.flat(), truth, atol=tolerance)


def test_a_toss_that_no_window_has_contributes_nothing(of_flight: tuple[Evidence, Hypothesis]) -> None:
    evidence, hypothesis = of_flight
    residuals = evidence.residuals(hypothesis.world())
    J = derivatives(evidence, hypothesis, residuals)
    H, g = toss_sums(evidence, residuals, J, evidence.scales(residuals), 20)
    assert not H[12:].any()
    assert not g[12:].any()
    assert (H[np.unique(evidence.windows.toss)] > 0).all()


def test_values_of_a_part_are_near_those_of_a_fit_to_it(of_flight: tuple[Evidence, Hypothesis]) -> None:
    evidence, hypothesis = of_flight
    fitted = fit(evidence, hypothesis, n_tosses=12)
    part = np.arange(12) % 2 == 0
    alone = fit(evidence.of_tosses(part), hypothesis, n_tosses=12).hypothesis.flat()
    error = float(np.sqrt(fitted.covariance()[0, 0]))
    np.testing.assert_allclose(fitted.of_part(part).flat(), alone, atol=error)
    assert abs(fitted.hypothesis.flat()[0] - 9.7) < 4 * error


def test_scatter_tells_an_effect_that_differs_from_toss_to_toss(cube: ObjectModel) -> None:
    """An effect that is the same in all tosses scatters by noise, one that is drawn for each by far more."""

    def scatter(gravities: np.ndarray) -> tuple[float, float]:
        tosses = [seen(World(cube, gravity=g), cube, 1, seed=k)[0] for k, g in enumerate(gravities)]
        windows = make_windows(tosses, cube)
        windows = windows.rows(np.flatnonzero(windows.free))
        start = Hypothesis(World(cube)).plus(EFFECTS["gravity"])
        fitted = fit(Evidence(*linearise(windows, World(cube))), start, n_tosses=len(tosses))
        assert isinstance(fitted, Fitted)
        assert fitted.scales[FREE] >= 1
        return fitted.scatter("gravity")

    same, different = scatter(np.full(14, 9.0)), scatter(np.linspace(8.0, 9.6, 14))
    assert same[0] < 2.5
    assert different[0] > 10
    assert different[1] > 10 * same[1]
