"""What size of an effect tosses would reveal, and what each effect closed when it joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.effect_findings import closed_by_each, detectable_sizes
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.fixture(scope="module")
def validator(cube: ObjectModel) -> CrossValidator:
    truth = EFFECTS["gravity"].at(World(cube.with_changes(friction=0.3)), np.array([9.0]))
    return CrossValidator.of(seen(truth, cube, 8, seed=3), cube, seed=0)


def test_more_tosses_reveal_less(cube: ObjectModel, validator: CrossValidator) -> None:
    present = validator.evaluate(Hypothesis(World(cube)))
    half = present.evidence.windows.toss < 4
    part = replace(present.fitted, evidence=present.evidence.rows(np.flatnonzero(half)))
    part = replace(part, residuals=present.fitted.residuals[half])
    (whole, seen_whole), (less, _) = (
        detectable_sizes(validator, each, EFFECTS["gravity"]) for each in (present, replace(present, fitted=part))
    )
    assert seen_whole
    assert less["g_ms2"] == pytest.approx(np.sqrt(2) * whole["g_ms2"], rel=0.4)
    assert 1e-3 < whole["g_ms2"] < 0.5


def test_a_size_that_tosses_reveal_is_four_standard_errors(cube: ObjectModel, validator: CrossValidator) -> None:
    truth = World(cube.with_changes(friction=0.3))
    with_gravity = Hypothesis(truth).plus(EFFECTS["gravity"], np.array([9.0]))
    present = validator.evaluate(with_gravity)
    fitted = validator.refit(present.evidence, with_gravity, 2)
    at = replace(present, fitted=fitted)
    sizes, _ = detectable_sizes(validator, at, EFFECTS["gravity"])
    error = float(np.sqrt(fitted.covariance()[0, 0]))
    assert 0.5 < sizes["g_ms2"] / (validator.settings.verdict.detectable * error) < 2.0


def test_an_effect_closes_what_it_closed_beyond_those_before_it(cube: ObjectModel, validator: CrossValidator) -> None:
    nothing = Hypothesis(World(cube))
    friction = nothing.plus(EFFECTS["friction"], np.array([0.3]))
    both = friction.plus(EFFECTS["gravity"], np.array([9.0]))
    history = tuple(validator.evaluate(each) for each in (nothing, friction, both))
    found = SearchResult(history[0], history[-1], history, {}, {}, {}, {})
    closed = closed_by_each(validator, found, noise_floor(validator.windows))
    assert list(closed) == ["friction", "gravity"]
    assert closed["friction"].value > 0.1
    assert closed["gravity"].value > 0.01
    assert 0.8 < closed["friction"].value + closed["gravity"].value < 1.1
