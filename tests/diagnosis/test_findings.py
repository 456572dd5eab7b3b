"""The parts of a result in the form that gap.json has."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, finding
from tossid.diagnosis.findings import Brings, Felt, Interval, mean_over_tosses, ratio_over_tosses

ONE = Interval(1.0, 0.5, 1.5)


def test_an_interval_is_a_value_with_its_ends() -> None:
    assert ONE.as_json() == {"value": 1.0, "ci95": [0.5, 1.5]}


def test_an_effect_is_written_with_all_that_was_found_of_it() -> None:
    made = finding(EFFECTS["friction"], "identified", parameters={"mu": ONE}, gap_closed=ONE)
    found = made.as_json()
    assert (found["name"], found["verdict"]) == ("friction", "identified")
    assert found["parameters"] == {"mu": ONE.as_json()}
    assert found["gap_closed"] == ONE.as_json()
    assert found["detectable"].keys() == {parameter.name for parameter in EFFECTS["friction"].parameters}
    assert found["phases"]


def test_an_effect_matters_where_whole_tosses_feel_it() -> None:
    friction = EFFECTS["friction"]
    for felt, matters in ((Felt(0.6, 0.0), True), (Felt(0.0, 0.6), True), (Felt(0.5, 0.5), False)):
        found = finding(friction, "confusable", felt=felt)
        assert found.matters == matters
        assert found.as_json()["matters"] == matters
        assert found.as_json()["whole_tosses"] == {"position_pct": felt.position_pct, "rotation_deg": felt.rotation_deg}
    assert not finding(friction, "not_supported").matters
    assert not Felt(0.9, 0.3).is_over(Felt(1.0, 0.1))


def test_only_tosses_that_end_before_and_after_are_compared() -> None:
    before = np.array([[4.0, 2.0], [6.0, 1.0], [np.nan, np.nan]])
    made = Brings("mujoco", before, before / 2, 0.1)
    assert made.n == 2
    assert [x.value for x in made.position_pct()] == [5.0, 2.5]
    assert [x.value for x in made.position_mm()] == [5.0, 2.5]
    assert made.left == Felt(2.5, 0.75)
    nothing = Brings("tossid", np.full((2, 2), np.nan), before[:2], 0.1)
    assert nothing.n == 0
    assert nothing.left.is_over()


def test_what_is_left_is_felt_where_clearly_more_than_half_of_the_tosses_show_it() -> None:
    nothing = Felt(0.0, 0.0)

    def felt(over: int, noise: Felt = nothing, *, lost: int = 0) -> bool:
        after = np.full((16, 2), 0.1)
        after[:over, 1] = 0.7
        after[:lost] = np.nan
        return Brings("tossid", after, after, 0.1).is_felt(noise)

    assert not felt(10)  # half and one standard error, which is two
    assert felt(11)
    assert not felt(16, Felt(0.0, 0.8))
    assert felt(0, lost=11)


def test_means_over_tosses_have_intervals_that_hold_them() -> None:
    """95 % percentile intervals of means over 30 tosses, in 200 draws."""
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(200):
        found = mean_over_tosses(rng.normal(3.0, 1.0, 30))
        inside += found.low <= 3.0 <= found.high
    assert 178 <= inside <= 199


def test_the_interval_of_a_ratio_covers_it() -> None:
    """95 % intervals of a ratio of sums over 40 tosses, in 200 draws."""
    inside = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        below = rng.uniform(1, 3, 40)
        ratio = ratio_over_tosses(0.4 * below + rng.normal(0, 0.3, 40), below)
        inside += ratio.low <= 0.4 <= ratio.high
    assert 180 <= inside <= 198
