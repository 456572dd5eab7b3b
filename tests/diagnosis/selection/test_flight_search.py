"""A force of another law, or of another size in each toss, has no name."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, Forces, World
from tossid.physics.forces import DRAG

NAMES = {effect.name: effect for effect in LIBRARY}


def test_a_drag_of_another_power_has_no_name(cube: ObjectModel) -> None:
    """Its nearest in the library closes most of the gap, and is not it."""
    library = [NAMES[name] for name in ("linear_drag", "quadratic_drag", "gravity", "com_offset")]
    for power, named in ((2.0, ()), (1.0, ("quadratic_drag",))):
        forces = Forces(linear=0.12, powered=DRAG, power=power)
        found = explain(seen(World(cube, forces=forces), cube, 16, seed=7), World(cube), library=library)
        assert found.named == named
        assert (found.verdict == "unexplained") == (not named)
        for name, further in found.other_laws:
            assert (name, found.unexplained[0].name) == ("quadratic_drag", "flight")
            assert further.low < 1.0 < further.high
            # contact is searched in the world of the force that was found
            assert further.low < found.hypothesis.base.forces.power < further.high
    assert not found.other_laws


def test_a_force_that_changes_from_toss_to_toss_has_no_name(cube: ObjectModel) -> None:
    """It pulls to one side, and so would its nearest in the library, which however is always the same."""
    library = [NAMES[name] for name in ("uniform_force", "gravity", "friction")]
    for force, named in ((np.linspace(0.03, 0.3, 18), ()), (np.full(18, 0.15), ("uniform_force",))):
        tosses = [seen(World(cube, forces=Forces(x=x)), cube, 1, seed=seed)[0] for seed, x in enumerate(force)]
        found = explain(tosses, World(cube), library=library)
        assert found.named == named
        assert found.unsteady == (() if named else ("uniform_force",))
        assert (found.verdict == "unexplained") == (not named)


def test_without_flight_nothing_is_searched(cube: ObjectModel) -> None:
    validator = CrossValidator.of(seen(World(cube), cube, 2, seed=1), cube, seed=0)
    grounded = CrossValidator(validator.windows.rows(np.flatnonzero(~validator.windows.free)), 2, validator.folds)
    assert search_flight(grounded, [NAMES["gravity"]], Hypothesis(World(cube))) is None
