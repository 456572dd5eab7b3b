"""The verdict follows from what is left, and forces that flight makes sure do not hang on the law of contact."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, gap, hypothesis
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.findings import Interval, Share
from tossid.diagnosis.localisation.refusal import Growth, RolloutCheck
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.result import Verdict
from tossid.diagnosis.verdict import gap_verdict, names_that_stand, verdict_by_rollouts
from tossid.objects import ObjectModel
from tossid.physics.effects import World

FINE, WORSE = Growth(-4.0, -2.0, -5.7, 1.0, 0.05), Growth(3.0, -0.2, 2.8, 1e-4, 0.05)


@pytest.mark.parametrize(
    ("verdict", "whole", "effects", "after"),
    [
        ("explained", FINE, {"friction": FINE, "inertia": FINE}, "explained"),
        ("explained", FINE, {"friction": FINE, "inertia": WORSE}, "partly_explained"),
        ("partly_explained", FINE, {"friction": FINE, "inertia": WORSE}, "partly_explained"),
        ("partly_explained", FINE, {"friction": WORSE, "inertia": WORSE}, "unexplained"),
        ("explained", WORSE, {"friction": FINE, "inertia": FINE}, "unexplained"),
        ("within_solver_disagreement", WORSE, {}, "within_solver_disagreement"),
        ("no_gap", WORSE, {}, "no_gap"),
    ],
)
def test_effects_that_are_refused_explain_nothing(
    verdict: Verdict, whole: Growth, effects: dict[str, Growth], after: str
) -> None:
    check = RolloutCheck(20, 20, whole, tuple(effects.items()))
    assert verdict_by_rollouts(verdict, check, tuple(effects)) == after
    assert verdict_by_rollouts(verdict, None, tuple(effects)) == verdict


SOME = Share("slide", Interval(0.2, 0.1, 0.3))


@pytest.mark.parametrize(
    ("before", "after", "closed", "unnamed", "unexplained", "named", "verdict"),
    [
        (1.02, 1.02, 0.0, (), (), False, "no_gap"),
        (3.0, 3.0, 0.0, (), (), False, "unexplained"),
        (1.02, 1.0, 0.9, ("vortex",), (), False, "unexplained"),  # something is there, and has no name
        (3.0, 1.01, 0.99, (), (), True, "explained"),
        (3.0, 1.01, 0.7, (), (SOME,), True, "explained"),
        (9.0, 1.5, 0.95, (), (), True, "explained"),
        (9.0, 1.5, 0.95, (), (SOME,), True, "partly_explained"),
        (3.0, 1.01, 0.99, ("vortex",), (), True, "partly_explained"),
        (3.0, 2.0, 0.6, (), (SOME,), True, "partly_explained"),
        (3.0, 2.5, 0.3, (), (SOME,), True, "unexplained"),
        # a small gap is near its floor however little of it is closed
        (1.025, 1.01, 0.3, (), (SOME,), True, "unexplained"),
    ],
)
def test_verdict(
    before: float,
    after: float,
    closed: float,
    unnamed: tuple[str, ...],
    unexplained: tuple[Share, ...],
    named: bool,
    verdict: str,
) -> None:
    share = Interval(closed, closed - 0.05, closed + 0.05)
    found = gap_verdict(gap(before, n=8), gap(after, n=8), share, unnamed, unexplained, any_named=named)
    assert found == verdict


@pytest.mark.parametrize(
    ("within", "mattering", "verdict", "standing"),
    [
        (False, ("friction",), "unexplained", set()),
        (True, ("friction",), "partly_explained", {"friction"}),
        (True, (), "unexplained", {"friction"}),
    ],
)
def test_names_of_contact_stand_where_solvers_disagree_as_much_as_is_left(
    cube: ObjectModel, within: bool, mattering: tuple[str, ...], verdict: Verdict, standing: set[str]
) -> None:
    windows = SimpleNamespace(inside=np.zeros((1, 1), bool), free=np.zeros(1, bool))
    there, nothing = hypothesis(cube, friction=[0.21]), np.zeros((1, 1, 1))
    present = SimpleNamespace(hypothesis=there, evidence=SimpleNamespace(windows=windows), judged=nothing)
    present.fitted = SimpleNamespace(hypothesis=there, residuals=nothing)
    found = SimpleNamespace(present=present, n_flight=0, unnamed=frozenset(), classes={})
    floor = SimpleNamespace(rms=1.0)
    got = names_that_stand(
        "unexplained",
        mattering,
        cast(Any, found),
        cast(Any, SimpleNamespace(settings=ONCE, n=1, folds=())),
        cast(Any, floor),
        within_disagreement=within,
    )
    assert got == (verdict, standing)


@pytest.mark.parametrize(
    ("name", "values", "key", "others"),
    [
        ("uniform_force", [0.06, -0.03, 0.0], "x_n", []),
        pytest.param("gravity", [9.6], "g_ms2", [], marks=pytest.mark.slow),
        ("time_base", [1.012], "rate_rel", ["gravity"]),
        pytest.param("com_offset", [0.004, -0.003, 0.003], "x_m", ["body_frame_offset"], marks=pytest.mark.slow),
    ],
)
def test_what_flight_makes_certain_is_named_although_contact_stays_unexplained(
    cube: ObjectModel, name: str, values: list[float], key: str, others: list[str]
) -> None:
    """The bounce is in no effect of the library, and leaves most of the gap.

    Rigid contact has no time scale, so a clock and a gravity of 9.81 / rate² are one, and either may lead.
    """
    truth = hypothesis(cube, restitution=[0.6], **{name: values}).world()
    library = [EFFECTS[each] for each in (name, "friction", "inertia", *others)]
    found = explain(Problem(seen(truth, cube, 14, seed=5), World(cube), library=library, settings=ONCE))
    assert found.verdict == "partly_explained"
    assert found.gap_closed.value < 0.5
    same = {name: (key, values[0])}
    if name == "time_base":
        same["gravity"] = ("g_ms2", 9.81 / values[0] ** 2)
    (leads,) = found.named
    assert leads in same
    force = next(each for each in found.findings if each.name == leads)
    assert force.verdict == ("confusable" if others else "identified")
    assert {leads, *force.confusable_with} == {name, *others}
    key, value = same[leads]
    assert force.parameters[key].low < value < force.parameters[key].high
    assert set(found.candidates) == set(found.hypothesis.names) - {leads} - set(found.minor)


def test_what_also_moves_the_body_s_points_needs_contact_to_agree(cube: ObjectModel) -> None:
    """In flight a frame that is off looks like a centre of mass that is off. Contact contradicts that."""
    truth = hypothesis(cube, body_frame_offset=[0.012, -0.008, 0.01]).world()
    library = [EFFECTS[name] for name in ("com_offset", "friction")]
    found = explain(Problem(seen(truth, cube, 14, seed=5), World(cube), library=library, settings=ONCE))
    assert found.verdict == "unexplained"
    assert found.named == ()
