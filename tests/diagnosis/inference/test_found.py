"""Two hypotheses are alike where the difference of their likelihoods is within its noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.inference.found import Found, Rival
from tossid.diagnosis.inference.hypothesis import Hypothesis


def test_a_rival_is_alike_unless_it_is_clearly_behind() -> None:
    noise = np.random.default_rng(0).normal(size=12)
    fit: Any = None
    assert Rival(EFFECTS["gravity"], fit, noise).is_alike
    assert not Rival(EFFECTS["gravity"], fit, noise - 3.0).is_alike


def test_what_flight_has_found_is_told_from_what_contact_has(stated: Hypothesis) -> None:
    both = stated.plus(EFFECTS["gravity"]).plus(EFFECTS["friction"])

    def fitted(hypothesis: Hypothesis) -> Any:
        return SimpleNamespace(hypothesis=hypothesis)

    found = Found(cast(Any, None), fitted(both), fitted(both.without("friction")), ())
    assert found.flown == {"gravity"}
    assert found.hypothesis.names == ("gravity", "friction")
