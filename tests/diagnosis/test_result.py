"""A result and its parts in the form that gap.json has, and what follows from them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, diagnosis, finding, with_place, without_effects
from tossid.diagnosis.effect_findings import changes, size_of
from tossid.diagnosis.findings import Brings, Felt, Interval, mean_over_tosses, ratio_over_tosses
from tossid.diagnosis.localisation.place import Corner
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.objects import ObjectModel

ONE = Interval(1.0, 0.5, 1.5)


def test_the_whole_is_written_as_the_contract_has_it(cube: ObjectModel) -> None:
    made = replace(
        with_place(cube),
        unexplained={"impact": Interval(0.07, 0.02, 0.12)},
        witnesses=(Witness("rebound", "restitution", 0.0, 0.31, Interval(0.3, 0.25, 0.35), 7, contradicts=True),),
    )
    found = made.as_json()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    explanation, gap, brings = found["explanation"], found["gap"], found["brings"]
    assert (explanation["verdict"], explanation["effects"], explanation["minor"]) == ("explained", ["friction"], [])
    assert explanation["unexplained_share"] == pytest.approx(1 - explanation["gap_closed"]["value"])
    assert explanation["unexplained_where"] == [{"phase": "impact", "share": 0.07, "ci95": [0.02, 0.12]}]
    assert (explanation["draws"], explanation["folds"], explanation["probability_none"]) == (800, 4, 0.0)
    assert found["change"] == [{"name": "friction", "parameter": "mu", "from": 0.18, "to": 0.3, "ci95": [0.297, 0.303]}]
    assert brings["in"] == "tossid"
    assert brings["position_error_pct"]["before"] == pytest.approx(12.5)
    assert brings["position_error_mm"]["after"] == pytest.approx(0.003 * 104.8)
    assert brings["rotation_error_deg"]["after"] == pytest.approx(0.15)
    low, high = brings["position_error_pct"]["ci95"]["after"]
    assert low < brings["position_error_pct"]["after"] < high
    assert gap["total"] == {"value": 5.0, "ci95": [4.5, 5.5], "unit": "standard deviations of noise"}
    assert (gap["noise_floor"], gap["position_mm"]) == (1.0, pytest.approx(1.0))
    assert [row["phase"] for row in gap["by_phase"]] == ["flight", "impact", "slide", "roll", "rest"]
    assert sum(row["share"] for row in gap["by_channel"]) == pytest.approx(1.0)
    assert len(gap["by_corner"]) == len(found["gap_left"]["by_corner"]) == 8
    assert [row["phase"] for row in gap["wrench"]] == ["flight", "contact"]
    assert [len(row["curve"]) for row in found["gap_left"]["wrench"]] == [5]
    (witness,) = found["witnesses"]
    assert (witness["measured"], witness["predicted"]) == ({"value": 0.3, "ci95": [0.25, 0.35]}, None)
    friction = found["effects"][0]
    assert (friction["name"], friction["verdict"], friction["matters"]) == ("friction", "confusable", True)
    assert friction["parameters"] == {"mu": {"value": 0.3, "ci95": [0.297, 0.303]}}
    assert friction["whole_tosses"] == {"position_pct": 12.1, "rotation_deg": 5.2}
    assert friction["detectable"].keys() == {"mu"}
    assert not {"felt", "over_order", "sessions", "drift"} & friction.keys()


def test_a_corner_that_never_touches_has_no_share_per_frame() -> None:
    assert Corner((0.05, -0.05, 0.05), ONE, 0, None).as_json() == {
        "corner": [0.05, -0.05, 0.05], "link": 0, "share": 1.0, "ci95": [0.5, 1.5], "frames": 0, "per_frame": None,
    }  # fmt: skip


def test_an_effect_that_whole_tosses_do_not_feel_is_minor(cube: ObjectModel) -> None:
    made = diagnosis(cube)

    def with_first(**changed: object) -> tuple[tuple[str, ...], ...]:
        other = replace(made, findings=(replace(made.findings[0], **changed), *made.findings[1:]))  # type: ignore[arg-type]
        return other.named, other.candidates, other.minor

    assert with_first() == (("friction",), (), ())
    assert with_first(felt=Felt(0.4, 0.4)) == ((), (), ("friction",))
    assert with_first(verdict="candidate") == ((), ("friction",), ())
    # what may be there in its place is not found beside it
    assert [f.name for f in made.found] == ["friction"]


def test_the_unexplained_share_is_never_negative(cube: ObjectModel) -> None:
    over = replace(diagnosis(cube), gap_closed=Interval(1.04, 0.9, 1.1))
    assert over.as_json()["explanation"]["unexplained_share"] == 0.0
    nothing = without_effects(cube, "unexplained").as_json()["explanation"]
    assert (nothing["unexplained_share"], nothing["effects"]) == (1.0, [])


def test_its_main_numbers_are_flat_and_finite(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    found = made.metrics()
    assert (found["gap_total"], found["n_effects"], found["gap_closed"]) == (5.0, 1.0, made.gap_closed.value)
    assert found["position_error_pct/after"] == pytest.approx(0.3)
    assert any(name.startswith("friction/") for name in found)
    assert "gap_closed" not in replace(made, gap_closed=Interval(float("nan"), 0.0, 1.0)).metrics()


@pytest.mark.parametrize(
    ("felt", "noise", "over"),
    [
        (Felt(0.6, 0.0), None, True),
        (Felt(0.0, 0.6), None, True),
        (Felt(0.5, 0.5), None, False),
        (Felt(0.9, 0.3), Felt(1.0, 0.1), False),
        (None, None, False),
    ],
)
def test_an_effect_matters_where_whole_tosses_feel_it(felt: Felt | None, noise: Felt | None, over: bool) -> None:
    if noise is None:
        assert finding(EFFECTS["friction"], "confusable", felt=felt).matters == over
    if felt is not None:
        assert felt.is_over(noise) == over


def test_what_whole_tosses_feel_most_is_changed_first() -> None:
    small = finding(EFFECTS["gravity"], "identified", parameters={"g_ms2": ONE}, felt=Felt(0.4, 0.8))
    large = finding(EFFECTS["friction"], "candidate", parameters={"mu": ONE}, felt=Felt(3.0, 0.1))
    minor = finding(EFFECTS["magnus"], "identified", parameters={"c_ns2pm": ONE}, felt=Felt(0.4, 0.4))
    found = [(each.name, each.parameter, each.stated) for each in changes([small, minor, large])]
    assert found == [("friction", "mu", 0.18), ("gravity", "g_ms2", 9.81)]
    # a percent counts as much as a degree
    assert size_of(Felt(2.0, 1.0)) == size_of(Felt(1.0, 2.0)) == 2.0
    assert size_of(None) == 0.0


def test_only_tosses_that_end_before_and_after_are_compared() -> None:
    before = np.array([[4.0, 2.0], [6.0, 1.0], [np.nan, np.nan]])
    made = Brings("mujoco", before, before / 2, 0.1)
    assert (made.n, made.left) == (2, Felt(2.5, 0.75))
    assert [x.value for x in made.position_pct()] == [x.value for x in made.position_mm()] == [5.0, 2.5]
    nothing = Brings("tossid", np.full((2, 2), np.nan), before[:2], 0.1)
    assert nothing.n == 0
    assert nothing.left.is_over()


@pytest.mark.parametrize(
    ("over", "noise", "lost", "felt"),
    [(10, 0.0, 0, False), (11, 0.0, 0, True), (16, 0.8, 0, False), (0, 0.0, 11, True)],
    ids=["half and one standard error", "more", "no more than noise", "diverged"],
)
def test_what_is_left_is_felt_where_clearly_more_than_half_show_it(
    over: int, noise: float, lost: int, felt: bool
) -> None:
    after = np.full((16, 2), 0.1)
    after[:over, 1] = 0.7
    after[:lost] = np.nan
    assert Brings("tossid", after, after, 0.1).is_felt(Felt(0.0, noise)) == felt


def test_intervals_over_tosses_hold_means_and_ratios() -> None:
    """95 % percentile intervals over 30 and 40 tosses, in 200 draws."""
    inside = np.zeros(2)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        mean = mean_over_tosses(rng.normal(3.0, 1.0, 30))
        below = rng.uniform(1, 3, 40)
        ratio = ratio_over_tosses(0.4 * below + rng.normal(0, 0.3, 40), below)
        inside += [mean.low <= 3.0 <= mean.high, ratio.low <= 0.4 <= ratio.high]
    assert (inside >= 178).all()
    assert (inside <= 199).all()
