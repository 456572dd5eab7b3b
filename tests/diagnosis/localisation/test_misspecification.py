"""What the diagnosis leaves of a world's own motions is near the noise floor."""

from __future__ import annotations

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.misspecification import misspecification
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_a_world_leaves_little_beyond_noise_of_its_own_motions(cube: ObjectModel) -> None:
    world = World(cube)
    validator = CrossValidator.of(seen(world, cube, 6, seed=1), cube, seed=0)
    floor = noise_floor(validator.windows)
    found = misspecification(validator.evaluate(Hypothesis(world)), validator, floor, seed=0)
    assert -0.2 < found.adds < 0.4
    assert found.as_json()["simulated_floor"] == found.adds + floor.rms
