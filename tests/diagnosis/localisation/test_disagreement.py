"""Two exact solvers of the same rigid body: alike in flight and in sliding, apart where corners hit."""

from __future__ import annotations

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.disagreement import solver_disagreement
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_they_differ_beyond_noise_where_corners_hit(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=2)
    validator = CrossValidator.of(tosses, cube, seed=0)
    state = validator.evaluate(Hypothesis(World(cube)))
    found = solver_disagreement(state, validator, seed=0)
    assert 1.0 < found.gap < 4.0
    assert 0.05 < found.position_mm < 10.0
    assert found.rotation_deg < 20.0
    assert found.as_json() == {
        "gap": found.gap,
        "position_mm": found.position_mm,
        "rotation_deg": found.rotation_deg,
    }
