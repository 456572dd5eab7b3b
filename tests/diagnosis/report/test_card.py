"""The card says what to change, what that brings, how sure it is, what else it may be, what is left, and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, brings, diagnosis, finding, without_effects
from tests.diagnosis.report.test_words import RELEASE
from tossid.diagnosis.findings import Brings, Change, ChangeLeft, Felt, Interval, OverOrder, Stretch
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.report.card import VERDICTS, card_of
from tossid.diagnosis.result import Diagnosis, Interruption
from tossid.objects import ObjectModel


def rows(made: Diagnosis) -> dict[str, str]:
    return {label: " | ".join(lines) for label, lines in card_of(made).rows.items()}


def test_it_says_everything_in_its_order(cube: ObjectModel) -> None:
    made = replace(
        diagnosis(cube), patch={"mjcf": "<mujoco/>"}, brings=replace(brings(5.8, 0.34, n=20), engine="mujoco")
    )
    assert card_of(made).headline == "The gap is explained: friction or cohesion"
    said = rows(made)
    assert list(said) == ["Change", "It brings", "How sure", "Alternatives", "Left", "Do next"]
    assert said["Change"] == "friction: mu 0.18 → 0.3000 (95 %: 0.2970 to 0.3030)"
    # 5.8 % and 0.34 % of 104.8 mm
    assert said["It brings"] == (
        "Position error 6.1 → 0.36 mm (5.8 → 0.34 % of the width), rotation error 2.9 → 0.17 deg. | "
        "Means of 20 whole tosses in MuJoCo, each predicted by what was found without it."
    )
    assert said["How sure"] == (
        "Named in 800 resampled searches: friction or cohesion 97 %. | "
        "These are 4 searches, each without a quarter of the tosses, and 200 draws of the tosses of each."
    )
    assert said["Alternatives"] == "Instead of friction it may be cohesion, c 0.20 N (0.15 to 0.25)."
    assert said["Left"].startswith("Half of the whole tosses are off by at most 0.34 % of the width and 0.17 deg: less")
    assert said["Do next"] == "Use patched.xml, which has the changes."


def test_it_is_the_same_on_the_console(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    lines = repr(made).splitlines()
    assert lines[0] == card_of(made).headline
    assert lines[1] == "  Change        friction: mu 0.18 → 0.3000 (95 %: 0.2970 to 0.3030)"
    assert len(lines) == 1 + sum(map(len, card_of(made).rows.values()))


def test_changes_keep_their_order_and_their_units(cube: ObjectModel) -> None:
    changes = (
        Change("com_offset", "x_m", -3.6e-15, Interval(0.003, 0.0028, 0.0032)),
        Change("length_scale", "scale_rel", 1.0, Interval(1.016, 1.016, 1.016)),
        Change("com_offset", "y_m", 0.0, Interval(-1e-5, -2e-4, 1.5e-4)),
        Change("com_offset", "z_m", 0.0, Interval(-0.002, -0.0022, -0.0018)),
    )
    said = rows(replace(diagnosis(cube), change=changes))["Change"]
    assert said == (
        "com_offset: x 0 → 3.00 mm (95 %: 2.80 to 3.20), z 0 → −2.00 mm (95 %: −2.20 to −1.80); y may stay | "
        "length_scale (of the recording): scale 1 → 1.02"
    )


def test_a_value_that_stands_for_no_effect_is_no_value_of_the_simulator(cube: ObjectModel) -> None:
    speed = Change("velocity_friction", "speed_ms", 0.2, Interval(0.25, 0.2, 0.3))
    static = Change("velocity_friction", "static_mu", 0.18, Interval(0.26, 0.25, 0.27))
    said = rows(replace(diagnosis(cube), change=(static, speed)))["Change"]
    assert said.startswith("velocity_friction: static mu 0.18 → 0.260 (95 %: 0.250 to 0.270)")
    assert "0.2 →" not in said


def test_the_patch_in_mujoco_stands_beside_another_engine(cube: ObjectModel) -> None:
    run = {"engine": "MuJoCo 4", "position_error_pct": {"before": {"value": 7.5}, "after": {"value": 4.1}}}
    patched = replace(diagnosis(cube), patch={"mjcf": "<mujoco/>", "rerun": run})
    line = "In MuJoCo, whole tosses are off by 4.1 % of the width with the patch, 7.5 % without."
    assert line in rows(patched)["Do next"]
    assert line not in rows(replace(patched, brings=replace(patched.brings, engine="mujoco")))["Do next"]


def test_a_search_that_was_not_judged_says_so(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    said = rows(replace(made, folds=0, draws=0, brings=replace(made.brings, unseen=False)))
    assert said["How sure"] == "Not judged: the search was not repeated, so these names may be chance."
    assert said["It brings"].endswith("to which the changes were fitted.")


def test_what_is_not_sure_and_what_is_too_small_have_a_line_each(cube: ObjectModel) -> None:
    unsure = finding(
        EFFECTS["restitution"],
        "candidate",
        parameters={"e": Interval(0.13, 0.08, 0.18)},
        felt=Felt(2.0, 1.0),
        frequency=0.62,
    )
    small = finding(
        EFFECTS["gravity"], "identified", parameters={"g_ms2": Interval(9.79, 9.78, 9.8)}, felt=Felt(0.1, 0.1)
    )
    made = diagnosis(cube)
    change = Change("restitution", "e", 0.0, Interval(0.13, 0.08, 0.18))
    made = replace(
        made,
        verdict="partly_explained",
        findings=(*made.findings[:2], unsure, small),
        change=(*made.change, change),
        unexplained={"impact": Interval(0.3, 0.2, 0.4)},
        changes_left=(ChangeLeft("12", 0.001),),
        gap=replace(made.gap, odd=("3", "7")),
        probability_none=0.03,
    )
    assert card_of(made).headline == "The gap is partly explained: friction or cohesion; not sure: restitution"
    said = rows(made)
    assert said["Change"].endswith("restitution: e 0 → 0.13 (95 %: 0.08 to 0.18); not sure")
    assert "friction or cohesion 97 %, restitution 62 % and nothing 3 %" in said["How sure"]
    for line in (
        "Short windows are off by 0.24 mm and 0.12 deg, mostly at impacts (30 % of the gap).",
        "Too small to feel: gravity, g 9.790 m/s² (9.780 to 9.800).",
        "Something changes from toss 12 on, which no effect explains.",
        "Inspect toss 3 and 7: its errors are far larger than all others'.",
    ):
        assert line in said["Left"].split(" | "), line


@pytest.mark.parametrize(
    ("next_toss", "line"),
    [
        ({"release": RELEASE}, "This toss would tell: the lowest corner 12 cm above the ground, 1.50 m/s sideways"),
        ({"release": None, "reason": "nothing separates them"}, "No toss is proposed: nothing separates them."),
    ],
)
def test_the_toss_that_would_decide_is_one_line(cube: ObjectModel, next_toss: dict[str, object], line: str) -> None:
    assert line in rows(replace(diagnosis(cube), next_toss=next_toss))["Alternatives"]


def test_every_verdict_says_what_to_do(cube: ObjectModel) -> None:
    assert rows(without_effects(cube, "no_gap"))["Do next"].startswith("Nothing.")
    lost = rows(without_effects(cube, "unexplained", n=8))
    assert "mostly while sliding (70 % of the gap) and at impacts (20 % of the gap)" in lost["Left"]
    assert "check the recording there" in lost["Do next"]
    assert "Record at least 12 tosses" in lost["Do next"]
    solvers = SolverDisagreement(4.0, 0.9, 0.7)
    within = rows(replace(without_effects(cube, "within_solver_disagreement"), disagreement=solvers))
    assert "Another exact solver differs by up to 0.90 mm and 0.70 deg in contact." in within["Left"]
    assert within["Do next"].startswith("Nothing: ")
    stopped = Interruption("fitting friction", (("restitution", 30.0), ("inertia", 3.0)))
    made = replace(diagnosis(cube), verdict="incomplete", interruption=stopped, folds=0, draws=0)
    assert card_of(made).headline.startswith("Interrupted before the gap was explained")
    assert rows(made)["Do next"] == (
        "Run it to the end. It was interrupted in this stage: fitting friction. | "
        "Suspected, but not fitted yet: restitution and inertia."
    )
    for verdict in VERDICTS:
        assert rows(replace(diagnosis(cube), verdict=verdict))["Do next"]  # type: ignore[arg-type]


def test_whole_tosses_that_diverge_are_counted(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    after = made.brings.after.copy()
    after[:3] = np.nan
    some = replace(made, brings=Brings("python", made.brings.before, after, 0.1))
    assert "Means of 17 whole tosses in your simulator" in rows(some)["It brings"]
    assert rows(some)["It brings"].endswith("3 more diverged.")
    none = replace(made, brings=replace(made.brings, after=np.full_like(after, np.nan)))
    assert rows(none)["It brings"] == "Not known: every whole toss diverged in tossid's simulator."
    one = rows(replace(made, brings=brings(5.8, 0.34, n=1)))
    assert "One whole toss in tossid's simulator" in one["It brings"]


def test_errors_that_noise_makes_are_no_less_than_a_person_notices(cube: ObjectModel) -> None:
    said = rows(replace(diagnosis(cube), brings=brings(12.5, 0.8, n=20)))["Left"]
    assert said.endswith("no more than noise of the first states makes.")


def test_an_effect_that_changes_over_the_order_has_its_stretches(cube: ObjectModel) -> None:
    stretches = tuple(
        Stretch(first, last, 10, {"mu": Interval(x, x - 0.01, x + 0.01)})
        for first, last, x in (("0", "9", 0.2), ("10", "19", 0.3))
    )
    steps = OverOrder("steps", stretches, {}, 0.0005, undone=False)
    made = diagnosis(cube)
    friction = replace(made.findings[0], verdict="identified", confusable_with=(), over_order=steps, parameters={})
    made = replace(made, findings=(friction, *made.findings[2:]), change=())
    assert card_of(made).headline == "The gap is explained: friction, which changes"
    assert rows(made)["Change"] == (
        "friction changes: mu 0.200 (0.190 to 0.210) in tosses 0 to 9; mu 0.300 (0.290 to 0.310) in tosses 10 to 19 "
        "(p = 0.00050)"
    )
