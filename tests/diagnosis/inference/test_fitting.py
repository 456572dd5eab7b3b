"""Fits recover the parameters with which tosses were made, within their intervals."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample


def test_friction_is_recovered_from_what_is_stated(slippery: Sample, stated: Hypothesis) -> None:
    first = slippery.evidence(stated)
    made = fit(first, stated.plus(EFFECTS["friction"]), n=slippery.n, iterations=8, follow=1)
    value, error = (
        made.hypothesis.flat()[0],
        np.sqrt(made.columns.covariance()[0, 0]) * EFFECTS["friction"].parameters[0].step,
    )
    assert abs(value - FRICTION) < 3 * error
    assert error < 0.005
    assert made.wald("friction") > 60
    # one parameter of twelve tosses: each owes a little of its likelihood to its own part in the fit
    assert 0 < made.optimism().sum() < 5


def test_what_is_held_keeps_its_value(slippery: Sample, stated: Hypothesis) -> None:
    h = stated.plus(EFFECTS["gravity"], np.array([9.7])).plus(EFFECTS["friction"])
    made = fit(slippery.evidence(stated), h, n=slippery.n, iterations=3, held=frozenset({"gravity"}), follow=1)
    assert made.hypothesis.values_of("gravity").tolist() == [9.7]
    assert made.hypothesis.values_of("friction")[0] > 0.22
    assert made.columns_of("friction") == [0]
