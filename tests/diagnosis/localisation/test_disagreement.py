"""Two exact solvers of the same rigid body: alike in flight and in sliding, apart where corners hit."""

from __future__ import annotations

from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.evidence import collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.disagreement import left_of, solver_disagreement
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_they_differ_beyond_noise_where_corners_hit(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=2)
    found = solver_disagreement(collect(make_windows(tosses, cube), Hypothesis(World(cube))), seed=0)
    assert 1.0 < found.gap < 4.0
    assert 0.05 < found.position_mm < 10.0
    assert found.rotation_deg < 20.0
    assert found.as_json() == {
        "gap": found.gap,
        "position_mm": found.position_mm,
        "rotation_deg": found.rotation_deg,
    }


def test_a_world_leaves_little_beyond_noise_of_its_own_motions(cube: ObjectModel) -> None:
    evidence = collect(make_windows(seen(World(cube), cube, 6, seed=1), cube), Hypothesis(World(cube)))
    own = evidence.windows.predicted(evidence.hypothesis.world())
    assert 0.8 < left_of(own, evidence, seed=0) < 1.4
