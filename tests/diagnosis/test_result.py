"""A result and its parts in the form that gap.json has, what follows from them, and what is said beside."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, diagnosis, finding, with_place, without_effects
from tests.golden import assert_as_read
from tossid.diagnosis.effect_findings import changes, size_of
from tossid.diagnosis.findings import Brings, Felt, Interval, mean_over_tosses, ratio_over_tosses
from tossid.diagnosis.inference.hypothesis import RELAXED, ROUTH, ContactLaw
from tossid.diagnosis.localisation.place import Corner
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.remarks import remarks_on
from tossid.diagnosis.simulators import nominal
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
    brings = found["brings"]
    assert brings["position_error_mm"]["after"] == pytest.approx(10 * 0.1048 * brings["position_error_pct"]["after"])
    assert sum(row["share"] for row in found["gap"]["by_channel"]) == pytest.approx(1.0)
    assert found["explanation"]["unexplained_share"] == pytest.approx(1 - made.gap_closed.value)
    lines = list[str]()
    for key, value in _rounded(found).items():
        parts = (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else [("", value)]
        )
        lines += [f"{key}.{part}: {json.dumps(each)}\n" for part, each in parts]
    assert_as_read(Path(__file__).parent / "gap.txt", "".join(lines))


def _rounded(x: Any) -> Any:
    """To six digits, which no processor changes."""
    if isinstance(x, dict):
        return {key: _rounded(each) for key, each in x.items()}
    if isinstance(x, list | tuple):
        return [_rounded(each) for each in x]
    return float(f"{x:.6g}") if isinstance(x, float) else x


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


def test_main_numbers_are_flat_and_finite_and_shares_never_negative(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    found = made.metrics()
    assert (found["gap_total"], found["n_effects"], found["gap_closed"]) == (5.0, 1.0, made.gap_closed.value)
    assert found["position_error_pct/after"] == pytest.approx(0.3)
    assert any(name.startswith("friction/") for name in found)
    assert "gap_closed" not in replace(made, gap_closed=Interval(float("nan"), 0.0, 1.0)).metrics()
    over = replace(made, gap_closed=Interval(1.04, 0.9, 1.1)).as_json()["explanation"]
    nothing = without_effects(cube, "unexplained").as_json()["explanation"]
    assert (over["unexplained_share"], nothing["unexplained_share"], nothing["effects"]) == (0.0, 1.0, [])
    never = Corner((0.05, -0.05, 0.05), ONE, 0, None).as_json()
    assert (never["frames"], never["per_frame"]) == (0, None)


# ---------------------------------------------------------------- what is said beside it


def test_few_tosses_an_order_that_was_not_looked_at_and_another_law_of_contact_are_said(cube: ObjectModel) -> None:
    stated, made = nominal(cube), replace(diagnosis(cube, n=6), changes_left=())
    assert remarks_on(made, stated) == ()
    assert remarks_on(replace(without_effects(cube, "no_gap", n=6), changes_left=()), stated) == ()
    (few,) = remarks_on(replace(without_effects(cube, "unexplained", n=6), changes_left=()), stated)
    assert few.startswith("6 tosses are too few")
    (order,) = remarks_on(diagnosis(cube), stated)
    assert "too few for a change" in order
    own = replace(stated, mjcf=Path("cube.xml"), contact=(ContactLaw("own"),))
    for law, simulator, says in (
        (ROUTH, stated, "Routh's law"),
        (RELAXED, stated, "relaxed friction"),
        (made.hypothesis.law, own, "the patch makes the model's contact rigid"),
    ):
        (said,) = remarks_on(replace(made, hypothesis=replace(made.hypothesis, law=law)), simulator)
        assert says in said
