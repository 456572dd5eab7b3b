"""Each toss alone says what an effect is, as far as it can."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.tossed import seen
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.sessions.values import RESIDUAL, toss_values, witnesses_of
from tossid.motion.sessions.change_points import robust_mean
from tossid.objects import ObjectModel
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def test_tosses_say_an_effect_beside_a_hypothesis_and_within_it(cube: ObjectModel) -> None:
    truth = hypothesis(cube, world_tilt=[4e-3, -2e-3]).world()
    validator = CrossValidator.of(
        seen(truth, cube, 8, seed=3), cube, seed=0, n_threads=1, engine=None, settings=DiagnoseSettings()
    )
    stated, right = (validator.evaluate(hypothesis(cube, **values)) for values in ({}, {"world_tilt": [4e-3, -2e-3]}))
    values, info = toss_values(stated, EFFECTS["world_tilt"], validator.n)
    assert values.shape == (8, 2)
    step = EFFECTS["world_tilt"].parameters[0].step
    np.testing.assert_allclose(step * robust_mean(values, info).value, [4e-3, -2e-3], atol=1e-3)
    there, there_info = toss_values(right, EFFECTS["world_tilt"], validator.n)
    assert np.abs(step * robust_mean(there, there_info).value).max() < 5e-4
    assert (np.linalg.eigvalsh(info) > -1e-6 * info.max()).all()
    found = witnesses_of(stated, [EFFECTS["world_tilt"]], validator, np.zeros((8, 2)), np.arange(8.0))
    assert set(found) == {"world_tilt", RESIDUAL}
    np.testing.assert_allclose(found[RESIDUAL][0][:, 0], np.arcsinh(np.arange(8.0)))
