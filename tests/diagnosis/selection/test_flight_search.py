"""A force of another law, or of another size in each toss, has no name."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.flight_search import power_law_of, search_flight
from tossid.diagnosis.selection.refinement import intervals
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import OTHER_POWER, Effect, Forces, World
from tossid.physics.forces import DRAG
from tossid.types import Toss

DRAGS = [EFFECTS[name] for name in ("linear_drag", "quadratic_drag", "gravity", "com_offset")]
PULLS = [EFFECTS[name] for name in ("uniform_force", "gravity", "friction")]


def dragged(cube: ObjectModel, power: float) -> list[Toss]:
    """Tosses with a drag by that power of the speed, beyond the first."""
    return seen(World(cube, forces=Forces(linear=0.12, powered=DRAG, power=power)), cube, 16, seed=7)


def pulled(cube: ObjectModel, force: np.ndarray) -> list[Toss]:
    """Tosses that are pulled to one side, each by its own force [N]."""
    return [seen(World(cube, forces=Forces(x=x)), cube, 1, seed=seed)[0] for seed, x in enumerate(force)]


def of_flight(tosses: list[Toss], cube: ObjectModel, library: list[Effect]) -> SearchResult:
    """What the search in flight alone finds."""
    found = search_flight(CrossValidator.of(tosses, cube, seed=0), library, Hypothesis(World(cube)))
    assert found is not None
    return found


def test_a_drag_of_another_power_is_found_to_be_another_law(cube: ObjectModel) -> None:
    found = of_flight(dragged(cube, 2.0), cube, DRAGS)
    assert found.present.hypothesis.names == ("quadratic_drag",)
    ((name, other),) = found.other_laws.items()
    assert name == "quadratic_drag"
    law = power_law_of(other, name)
    further = intervals(other.fitted, 16)[law.name][OTHER_POWER]
    assert further.low < 1.0 < further.high


@pytest.mark.slow
def test_a_drag_of_another_power_has_no_name_in_the_end(cube: ObjectModel) -> None:
    """Its nearest in the library closes most of the gap, and is not it."""
    found = explain(Problem(dragged(cube, 2.0), World(cube), library=DRAGS, settings=ONCE))
    assert (found.named, found.verdict) == ((), "unexplained")
    ((name, further),) = found.other_laws
    assert (name, found.unexplained[0].name) == ("quadratic_drag", "flight")
    assert further.low < 1.0 < further.high
    # contact is searched in the world of the force that was found
    assert further.low < found.hypothesis.base.forces.power < further.high


def test_a_drag_of_the_librarys_power_is_found_in_flight(cube: ObjectModel) -> None:
    found = of_flight(dragged(cube, 1.0), cube, DRAGS)
    assert found.present.hypothesis.names == ("quadratic_drag",)
    assert (found.other_laws, found.unsteady) == ({}, ())


def test_a_force_that_changes_from_toss_to_toss_has_no_name(cube: ObjectModel) -> None:
    """It pulls to one side, and so would its nearest in the library, which however is always the same."""
    found = of_flight(pulled(cube, np.linspace(0.03, 0.3, 18)), cube, PULLS)
    assert found.present.hypothesis.names == ("uniform_force",)
    assert (found.unsteady, found.unnamed) == (("uniform_force",), {"uniform_force"})


def test_a_force_that_does_not_change_is_found_in_flight(cube: ObjectModel) -> None:
    found = of_flight(pulled(cube, np.full(18, 0.15)), cube, PULLS)
    assert found.present.hypothesis.names == ("uniform_force",)
    assert (found.other_laws, found.unsteady) == ({}, ())


@pytest.mark.slow
@pytest.mark.parametrize("steady", [True, False])
def test_a_steady_force_alone_has_a_name_in_the_end(cube: ObjectModel, steady: bool) -> None:
    """Contact takes no name away, and adds none."""
    force = np.full(18, 0.15) if steady else np.linspace(0.03, 0.3, 18)
    found = explain(Problem(pulled(cube, force), World(cube), library=PULLS, settings=ONCE))
    assert found.named == (("uniform_force",) if steady else ())
    assert found.unsteady == (() if steady else ("uniform_force",))
    assert (found.verdict == "unexplained") == (not steady)


@pytest.mark.slow
def test_a_drag_of_the_librarys_power_is_named_in_the_end(cube: ObjectModel) -> None:
    found = explain(Problem(dragged(cube, 1.0), World(cube), library=DRAGS, settings=ONCE))
    assert found.named == ("quadratic_drag",)
    assert found.verdict != "unexplained"
    assert not found.other_laws


def test_without_flight_nothing_is_searched(cube: ObjectModel) -> None:
    validator = CrossValidator.of(seen(World(cube), cube, 2, seed=1), cube, seed=0)
    grounded = CrossValidator(validator.windows.rows(np.flatnonzero(~validator.windows.free)), 2, validator.folds)
    assert search_flight(grounded, [EFFECTS["gravity"]], Hypothesis(World(cube))) is None
