"""Effects come back by name and value, nothing is named of nothing, and the verdict follows from what is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, diagnosis, hypothesis
from tests.diagnosis.tossed import ONCE, seen, seen_with_joint, with_effect
from tossid.diagnosis.explain import explain, with_repeats
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.report.text import sentences
from tossid.diagnosis.selection.stability import Repeat, Stability
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, RecordingErrors, World, effects_for
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings

FEW = [EFFECTS[name] for name in ("com_offset", "gravity", "friction", "restitution", "length_scale", "linear_drag")]


def test_nothing_is_named_of_nothing(cube: ObjectModel) -> None:
    found = explain(Problem(seen(World(cube), cube, 14, seed=3), World(cube), library=FEW, settings=ONCE))
    assert found.named == ()
    assert found.verdict == "no_gap"
    assert found.rollouts is None


@pytest.mark.parametrize("repeats", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_two_effects_are_both_named(cube: ObjectModel, repeats: int) -> None:
    truth = EFFECTS["gravity"].at(EFFECTS["friction"].at(World(cube), np.array([0.25])), np.array([9.2]))
    settings = DiagnoseSettings(repeats=repeats)
    found = explain(Problem(seen(truth, cube, 16, seed=4), World(cube), library=FEW, settings=settings))
    assert set(found.named) == {"friction", "gravity"}
    if repeats:
        assert {each.name for each in found.findings if each.frequency == 1.0} >= {"friction", "gravity"}
        assert found.as_json()["explanation"]["probability_none"] == 0.0
    assert next(finding.verdict for finding in found.findings if finding.name == "friction") == "identified"
    assert found.gap_closed.value > 0.8
    assert found.rollouts is not None
    assert (found.rollouts.tosses, found.rollouts.unseen) == (16, 0)
    assert found.rollouts.refused == ()
    assert found.rollouts.whole.position_pct < -1.0
    values = {name: value for finding in found.findings for name, value in finding.parameters.items()}
    assert values["mu"].low - 0.002 < 0.25 < values["mu"].high + 0.002
    assert values["g_ms2"].low - 0.02 < 9.2 < values["g_ms2"].high + 0.02


def test_an_effect_out_of_the_library_does_not_explain(cube: ObjectModel) -> None:
    truth = EFFECTS["restitution"].at(World(cube), np.array([0.5]))
    library: list[Effect] = [effect for effect in FEW if effect.name != "restitution"]
    found = explain(Problem(seen(truth, cube, 14, seed=5), World(cube), library=library, settings=ONCE))
    assert found.verdict != "explained"
    assert found.gap_closed.value < 0.6


def test_recording_effects_move_what_is_recorded(cube: ObjectModel) -> None:
    tosses = seen(World(cube, recording=RecordingErrors(clock_rate=1.02)), cube, 14, seed=6)
    found = explain(
        Problem(
            tosses,
            World(cube),
            library=[EFFECTS["time_base"], EFFECTS["friction"], EFFECTS["com_offset"]],
            settings=ONCE,
        )
    )
    assert found.named[0] == "time_base"
    assert found.findings[0].parameters["rate_rel"].value == pytest.approx(1.02, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_damping", [2e-3]),
        pytest.param("joint_offset", [0.15], marks=pytest.mark.slow),
        pytest.param("joint_stiffness", [0.02, 0.5], marks=pytest.mark.slow),
    ],
)
def test_an_effect_of_the_joint_is_named_in_flight(elbow: ObjectModel, name: str, values: list[float]) -> None:
    tosses = seen_with_joint(with_effect(elbow, name, values), elbow, 14, seed=4, frames=36, height=1.0)
    few = ("joint_damping", "joint_friction", "joint_stiffness", "joint_offset", "gravity", "com_offset")
    found = explain(
        Problem(tosses, World(elbow), library=[each for each in effects_for(elbow) if each.name in few], settings=ONCE)
    )
    assert found.named == (name,)
    first = next(finding for finding in found.findings if finding.name == name)
    for interval, truth in zip(first.parameters.values(), values, strict=True):
        # four steps a frame leave half a percent of a tumbling link's rate
        assert interval.low - 0.01 * truth <= truth <= interval.high + 0.01 * truth
    if name == "joint_damping":
        assert (found.place.wrench[0].component, found.place.wrench[0].state) == ("torque_joint_1", "joint_1_rate")
        assert found.place.wrench[0].state_clear
    assert [share.name for share in found.gap.by_channel][-1] == "joint_1"


def test_nothing_is_named_of_a_sound_joint(elbow: ObjectModel) -> None:
    tosses = seen_with_joint(World(elbow), elbow, 12, seed=5, frames=36, height=1.0)
    few = ("joint_damping", "joint_offset", "gravity")
    found = explain(
        Problem(tosses, World(elbow), library=[each for each in effects_for(elbow) if each.name in few], settings=ONCE)
    )
    assert found.verdict == "no_gap"


def test_an_effect_that_moves_no_toss_is_no_headline(cube: ObjectModel) -> None:
    """With tolerances that nothing reaches, friction is found and is none."""
    truth = EFFECTS["friction"].at(World(cube), np.array([0.25]))
    tosses = seen(truth, cube, 12, seed=2, frames=70)
    some = [EFFECTS[name] for name in ("friction", "gravity")]
    settings = changed(ONCE, {"matters_position_pct": 1e3, "matters_rotation_deg": 1e3, "matters_closed": 1.0})
    found = explain(Problem(tosses, World(cube), library=some, settings=settings))
    assert found.named == ()
    assert found.minor == ("friction",)
    kept = found.as_json()
    assert kept["explanation"]["effects"] == []
    assert kept["explanation"]["minor"] == ["friction"]
    first = next(each for each in kept["effects"] if each["name"] == "friction")
    assert (first["verdict"], first["matters"]) == ("identified", False)
    assert any(line.startswith("Also seen, too small to matter: friction (mu") for line in sentences(found))


@pytest.mark.slow
def test_what_makes_whole_tosses_worse_is_a_candidate_at_most(cube: ObjectModel) -> None:
    """The adhesion is right, and helps short windows. The bounce that went with it is in no effect of the library."""
    truth = hypothesis(cube, restitution=[0.3], adhesion=[0.8]).world()
    unseen = [replace(toss, name=f"unseen {toss.name}") for toss in seen(truth, cube, 24, seed=6)]
    tosses, library = seen(truth, cube, 14, seed=5), [EFFECTS["adhesion"]]
    found = explain(Problem(tosses, World(cube), library=library, settings=ONCE, unseen=unseen))
    assert found.hypothesis.names == ("adhesion",)
    assert found.findings[0].evidence["gain"] > 50
    assert (found.named, found.candidates, found.verdict) == ((), ("adhesion",), "unexplained")
    assert found.findings[0].verdict == "candidate"
    kept = found.as_json()
    assert kept["explanation"]["refused"] == ["adhesion"]
    assert kept["rollouts"]["n_unseen"] == 24
    assert kept["rollouts"]["position_pct"] > 1.0
    assert kept["rollouts"]["p_value"] < 0.01
    assert any(line.startswith("Refused: with what was found") for line in sentences(found))


@pytest.mark.parametrize(("times", "sure"), [(10, True), (9, True), (8, False)])
def test_what_repeats_name_too_rarely_is_a_candidate(cube: ObjectModel, times: int, sure: bool) -> None:
    made = replace(diagnosis(cube), minor=("gravity",))
    repeats = tuple(Repeat(("friction",) if k < times else (), 0.9) for k in range(10))
    found = with_repeats(made, Stability(repeats))
    verdicts = {each.name: each.verdict for each in found.findings}
    assert found.named == (("friction",) if sure else ())
    assert found.candidates == (() if sure else ("friction",))
    assert found.verdict == ("explained" if sure else "partly_explained")
    assert verdicts["friction"] == ("confusable" if sure else "candidate")
    assert verdicts["gravity"] == "not_supported"
    assert next(each.frequency for each in found.findings if each.name == "friction") == times / 10
    little = with_repeats(replace(made, gap_closed=Interval(0.3, 0.2, 0.4)), Stability(repeats))
    assert little.verdict == ("explained" if sure else "unexplained")
    at_floor = replace(made.gap, total=Interval(1.02, 0.99, 1.05), noise_floor=1.0)
    nothing = with_repeats(replace(made, gap=at_floor), Stability(repeats))
    assert nothing.verdict == ("explained" if sure else "no_gap")


def test_without_repeats_names_stay(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    assert with_repeats(made, Stability(), {}).named == made.named


@pytest.mark.parametrize(("far", "sure"), [(0.3, True), (0.18, False)])
def test_what_may_be_no_change_in_repeats_is_a_candidate(cube: ObjectModel, far: float, sure: bool) -> None:
    """Every repeat names it, but at values that scatter beyond the stated friction."""
    made, stated = diagnosis(cube), World(cube).object.friction
    at = [{"friction": {"mu": far if k % 2 else 2 * 0.3 - far}} for k in range(10)]
    found = with_repeats(made, Stability(tuple(Repeat(("friction",), 0.9, parameters=each) for each in at)))
    said = next(each for each in found.findings if each.name == "friction")
    assert found.named == (("friction",) if sure else ())
    assert (said.parameters["mu"].low <= stated <= said.parameters["mu"].high) != sure
