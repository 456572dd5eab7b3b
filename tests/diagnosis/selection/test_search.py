"""Contact decides what flight cannot distinguish, and the search names effects of either."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search import search
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, RecordingErrors, World
from tossid.settings.changed import changed


@dataclass
class FakeCheck:
    """Tosses that measure and contradict what functions of a world say, and have the errors of another one.

    Attributes:
        of: What they contradict.
        error: Of each of the 14 whole tosses, position [% of the width] and rotation [deg] alike.
        asked: The worlds against which they were asked.
    """

    of: Callable[[World], dict[str, float]]
    error: Callable[[World], float] = lambda _: 1.0
    asked: list[World] = field(default_factory=list)

    def measured(self, found: World) -> dict[str, float]:
        """A bounce, whatever the world is."""
        return {"restitution": 0.4}

    def contradicted(self, found: World) -> dict[str, float]:
        """What the function says."""
        self.asked.append(found)
        return self.of(found)

    def errors(self, found: World) -> Any:
        """What the function says, of all tosses alike."""
        return np.full((14, 2), self.error(found))


@pytest.mark.slow
def test_contact_decides_what_flight_cannot_distinguish(cube: ObjectModel) -> None:
    """A missing bounce hides the height at which a shorter unit of length lets the cube rest."""
    truth = replace(
        EFFECTS["restitution"].at(World(cube), np.array([0.35])), recording=RecordingErrors(length_scale=0.985)
    )
    library = [EFFECTS[name] for name in ("gravity", "length_scale", "time_base", "restitution")]
    found = explain(Problem(seen(truth, cube, 16, seed=2), World(cube), library=library, settings=ONCE))
    assert set(found.named) == {"restitution", "length_scale"}
    bounce = next(each for each in found.findings if each.name == "restitution").parameters["e"]
    # steps eight times as long as those of the tosses bias it by 0.6 %, which is as much as its interval's half-width
    assert bounce.value == pytest.approx(0.35, rel=0.01)
    assert found.left.total.value < 1.3


SHORT_AND_TILTED = RecordingErrors(length_scale=0.97, world_tilt=(0.02, -0.03))


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"recording": SHORT_AND_TILTED}, {"length_scale", "world_tilt"}),
        ({"forces": Forces(x=0.11, y=0.07, z=0.11)}, {"uniform_force"}),
    ],
)
def test_contact_decides_between_one_force_and_the_two_causes_that_act_alike_in_flight(
    cube: ObjectModel, changes: dict[str, Any], names: set[str]
) -> None:
    tosses = seen(replace(World(cube), **changes), cube, 12, seed=3)
    validator = CrossValidator.of(tosses, cube, seed=0, settings=ONCE)
    asked = ("uniform_force", "gravity", "length_scale", "world_tilt", "ground_tilt", "geometry")
    first = validator.evaluate(Hypothesis(World(cube)))
    found = search(validator, [EFFECTS[name] for name in asked], first, UnderWay(), law_is_known=True)
    assert set(found.present.hypothesis.names) == names


def test_a_search_that_ends_too_early_begins_again_where_tosses_say(cube: ObjectModel) -> None:
    """Two effects, and one round of forward selection: the second search begins with what tosses say of both.

    What they say wrongly is given up again.
    """
    truth = World(cube.with_changes(restitution=0.4, inertia=1.4 * cube.inertia))
    tosses = seen(truth, cube, 14, seed=2)
    settings = changed(ONCE, {"selection.most_rounds": 1, "selection.most_joint_refits": 1})
    validator = CrossValidator.of(tosses, cube, seed=0, settings=settings)
    library = [EFFECTS[name] for name in ("inertia", "friction", "restitution")]
    first = validator.evaluate(Hypothesis(World(cube)))
    check = FakeCheck(lambda at: {"restitution": 0.35, "inertia": 1.3, "friction": 0.2})
    alone = search(validator, library, first, UnderWay())
    assert len(alone.present.hypothesis.effects) == 1
    again = search(validator, library, first, UnderWay(), check)
    assert (len(check.asked), again.begun_as_measured, alone.begun_as_measured) == (1, True, False)
    found = again.present.hypothesis
    assert set(found.names) == {"restitution", "inertia"}
    assert found.values_of("restitution")[0] == pytest.approx(0.4, abs=0.01)
    assert found.values_of("inertia")[0] == pytest.approx(1.4, rel=0.03)


def yields(world: World) -> bool:
    """Whether contact does."""
    return world.object.compliance > 0


@pytest.mark.parametrize(
    ("error", "names"),
    [
        (lambda at: 9.0 if yields(at) else 1.0, {"restitution"}),
        (lambda at: 1.0, {"compliance"}),  # so that nothing is searched again
        pytest.param(lambda at: 1.0 if at.object.restitution == 0.4 else 9.0, {"compliance"}, marks=pytest.mark.slow),
    ],
    ids=["both the measured bounce and the second answer are better", "neither", "the measured bounce alone"],
)
def test_a_stand_in_is_left_out_where_whole_tosses_refuse_it(
    cube: ObjectModel, error: Callable[[World], float], names: set[str]
) -> None:
    """Contact yields, but these tosses measure a bounce, with which whole tosses may be predicted better."""
    truth = EFFECTS["compliance"].at(World(cube), np.array([4000.0, 8.0, 0.0]))
    validator = CrossValidator.of(seen(truth, cube, 14, seed=2), cube, seed=0, settings=ONCE)
    library = [EFFECTS[name] for name in ("compliance", "restitution")]
    first = validator.evaluate(Hypothesis(World(cube)))
    found = search(validator, library, first, UnderWay(), FakeCheck(lambda _: {}, error))
    assert set(found.present.hypothesis.names) == names
    assert not {each.name for group in found.classes.values() for each in group} - names
    if names == {"restitution"}:
        assert found.refuted is not None
        assert found.refuted.names == ("compliance",)
        assert found.refuted.whole.position_pct == pytest.approx(8.0)
    else:
        assert found.refuted is None


def test_rounds_go_on_under_the_law_of_impacts_that_an_effect_reveals(cube: ObjectModel) -> None:
    """Slip turns in these impacts, which shows once the bounce is in; the friction is found under that law.

    All that is kept of the search, and would be reported if it were interrupted, is under one law then. A search that
    is told the law keeps it.
    """
    truth = EFFECTS["restitution"].at(World(cube.with_changes(friction=0.3)), np.array([0.4]))
    tosses = seen(replace(truth, law=truth.law._replace(impulse_parts=64.0)), cube, 14, seed=3)
    validator = CrossValidator.of(tosses, cube, seed=0, settings=ONCE)
    library = [EFFECTS[name] for name in ("restitution", "friction", "inertia")]
    first, under_way = validator.evaluate(Hypothesis(World(cube))), UnderWay()
    under_way.begun(tosses, validator, first)
    found, so_far = search(validator, library, first, under_way), under_way.so_far
    kept = found.first, *found.history, so_far.first, so_far.present
    laws = {each.hypothesis.base.law.impulse_parts for each in kept}
    assert laws == {8.0}
    values = dict(zip(found.present.hypothesis.names, found.present.hypothesis.values, strict=True))
    assert set(values) == {"restitution", "friction"}
    assert values["friction"] == pytest.approx(0.3, rel=0.02)
    told = search(validator, library, first, UnderWay(), law_is_known=True)
    assert told.first.hypothesis.base.law.impulse_parts == 1.0


def test_contact_decides_by_what_would_explain_it_beside_either(cube: ObjectModel) -> None:
    """Beside the wrong ground neither place of the mass fits; the ground is found beside the right one."""
    truth = World(cube.with_changes(restitution=0.17))
    for name, values in (("ground_height", [0.0285]), ("body_frame_offset", [-0.012, 0.0146, 0.0105])):
        truth = EFFECTS[name].at(truth, np.array(values))
    validator = CrossValidator.of(seen(truth, cube, 14, seed=2), cube, seed=0, settings=ONCE)
    library = [EFFECTS[name] for name in ("com_offset", "body_frame_offset", "ground_height", "restitution")]
    found = search(validator, library, validator.evaluate(Hypothesis(World(cube))), UnderWay()).present.hypothesis
    assert set(found.names) == {"body_frame_offset", "ground_height", "restitution"}
    assert found.values_of("ground_height")[0] == pytest.approx(0.0285, rel=0.03)


def test_an_inertia_is_found_beside_a_drag_of_spin_that_flight_knows_over_it(cube: ObjectModel) -> None:
    """Flight reveals the drag over the inertia, and contact the inertia; then the drag is another."""
    truth = EFFECTS["spin_drag"].at(World(cube.with_changes(inertia=0.5 * cube.inertia)), np.array([6e-4]))
    validator = CrossValidator.of(seen(truth, cube, 14, seed=2), cube, seed=0, settings=ONCE)
    library = [EFFECTS[name] for name in ("spin_drag", "inertia", "friction")]
    found = search(validator, library, validator.evaluate(Hypothesis(World(cube))), UnderWay()).present.hypothesis
    assert found.names == ("spin_drag", "inertia")
    assert np.concatenate(found.values) == pytest.approx([6e-4, 0.5], rel=0.03)
