"""Effects that step at different tosses are fitted together, with intervals that hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.stretches import Change, Stretch, fitted_together, windows_within
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

N = 18
TILT = [0.03, -0.02]


def tosses_of(cube: ObjectModel, worlds: Sequence[World], frames: int = 60) -> list[Toss]:
    return [seen(world, cube, 1, seed=100 + k, frames=frames)[0] for k, world in enumerate(worlds)]


def stepping(name: str, at: int, values: list[list[float]]) -> Change:
    keys = [p.name for p in EFFECTS[name].parameters]
    unknown = [{key: Interval(x, x, x) for key, x in zip(keys, each, strict=True)} for each in values]
    stretches = (Stretch(0, at, unknown[0]), Stretch(at, N, unknown[1]))
    return Change(EFFECTS[name], "steps", 0.001, 50.0, stretches, {}, np.repeat(values, [at, N - at], axis=0))


def test_steps_at_different_tosses_are_fitted_together(cube: ObjectModel, stated: Hypothesis) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    both = EFFECTS["world_tilt"].at(slippery, np.array(TILT))
    tosses = tosses_of(cube, [World(cube)] * 6 + [slippery] * 6 + [both] * 6)
    sample = Sample(windows_within(tosses, cube, (0, N)), N)
    begun = [stepping("friction", 6, [[0.2], [0.24]]), stepping("world_tilt", 12, [[0.002, 0.0], [0.025, -0.016]])]
    friction, tilt = fitted_together(sample.evidence(stated), begun, None)
    assert [(s.first, s.stop) for s in friction.stretches] == [(0, 6), (6, N)]
    truth = [(friction, "mu", [0.18, 0.26]), (tilt, "x_rad", [0.0, TILT[0]]), (tilt, "y_rad", [0.0, TILT[1]])]
    for change, key, values in truth:
        for stretch, true in zip(change.stretches, values, strict=True):
            found = stretch.values[key]
            half = found.high - found.value
            # no interval of few tosses is sure to hold: five of its standard errors are
            assert abs(found.value - true) < 2 * half + 1e-4
            assert 0 < half < (0.02 if key == "mu" else 2e-3)
    np.testing.assert_allclose(tilt.values[:12], np.tile([0.0, 0.0], (12, 1)), atol=5e-4)
    np.testing.assert_allclose(tilt.values[12:], np.tile(TILT, (6, 1)), atol=5e-4)
    assert friction.values[5, 0] == pytest.approx(friction.stretches[0].values["mu"].value)


def test_a_tilt_between_stretches_is_no_slow_error_within(cube: ObjectModel) -> None:
    worlds = [World(cube)] * 10 + [with_effect(cube, "world_tilt", [0.03, 0.0])] * 10
    tosses = tosses_of(cube, worlds, frames=140)
    whole, parted = (np.abs(windows_within(tosses, cube, edges).slow).max() for edges in ((0, 20), (0, 10, 20)))
    assert parted < 0.5 * whole
