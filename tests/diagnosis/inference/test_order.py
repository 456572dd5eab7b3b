"""What changes over the order of recording is found with its form, its place and its size, and nothing else is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.order import OverOrder, over_order
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.screening import Screening, screen
from tossid.diagnosis.inference.stretches import fitted_together
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

LIBRARY = tuple(EFFECTS[name] for name in ("friction", "gravity", "inertia", "world_tilt"))


def tosses_of(cube: ObjectModel, worlds: Sequence[World], frames: int = 60) -> list[Toss]:
    return [seen(world, cube, 1, seed=100 + k, frames=frames)[0] for k, world in enumerate(worlds)]


def beside_nothing(cube: ObjectModel, tosses: list[Toss], stated: Hypothesis) -> tuple[Fit, Screening]:
    sample = Sample(make_windows(tosses, cube), len(tosses))
    first = sample.evidence(stated)
    screening = screen(first, LIBRARY, n=sample.n, rng=np.random.default_rng(0))
    return sample.evaluated(first), screening


@pytest.fixture(scope="module")
def cleaned(cube: ObjectModel) -> list[Toss]:
    """24 tosses; before the eleventh the ground was cleaned."""
    return tosses_of(cube, [World(cube)] * 10 + [with_effect(cube, "friction", [0.26])] * 14)


def only_friction_steps(found: OverOrder, present: Fit) -> None:
    (change,) = fitted_together(present.evidence, found.changes)
    assert (change.effect.name, change.form) == ("friction", "steps")
    assert [stretch.first for stretch in change.stretches] == [0, 10]
    before, after = (stretch.values["mu"] for stretch in change.stretches)
    assert before.value == pytest.approx(0.18, abs=0.01)
    assert after.value == pytest.approx(0.26, abs=0.01)
    assert after.low - 0.003 < 0.26 < after.high + 0.003
    assert change.p_value <= 0.005
    assert change.values[:, 0].tolist() == pytest.approx([before.value] * 10 + [after.value] * 14)
    assert found.left is not None
    assert found.left > 0.005
    assert found.place is None


def test_a_step_is_found_at_its_place_with_its_size(cube: ObjectModel, stated: Hypothesis, cleaned: list[Toss]) -> None:
    present, screening = beside_nothing(cube, cleaned, stated)
    only_friction_steps(over_order(present, screening), present)


def test_an_effect_of_the_hypothesis_may_change_too(cube: ObjectModel, stated: Hypothesis, cleaned: list[Toss]) -> None:
    sample = Sample(make_windows(cleaned, cube), 24)
    same = stated.plus(EFFECTS["friction"], np.array([0.22]))
    present = sample.refitted(sample.evidence(same), same, iterations=3)
    rng = np.random.default_rng(0)
    screening = screen(present.evidence, LIBRARY, n=24, free=present.free, rng=rng)
    only_friction_steps(over_order(present, screening), present)


def test_an_effect_of_the_hypothesis_and_another_may_change(cube: ObjectModel, stated: Hypothesis) -> None:
    slippery = with_effect(cube, "friction", [0.26])
    tilted = EFFECTS["world_tilt"].at(slippery, np.array([0.03, -0.02]))
    tosses = tosses_of(cube, [World(cube)] * 12 + [tilted] * 12)
    sample = Sample(make_windows(tosses, cube), 24)
    same = stated.plus(EFFECTS["friction"], np.array([0.22]))
    present = sample.refitted(sample.evidence(same), same, iterations=3)
    screening = screen(present.evidence, LIBRARY, n=24, free=present.free, rng=np.random.default_rng(0))
    found = over_order(present, screening, boundaries=(12,))
    last = {change.effect.name: change.stretches[-1] for change in fitted_together(present.evidence, found.changes)}
    assert set(last) == {"friction", "world_tilt"}
    assert last["friction"].values["mu"].value == pytest.approx(0.26, abs=0.01)
    assert last["world_tilt"].values["x_rad"].value == pytest.approx(0.03, abs=5e-4)


def test_a_drift_has_its_rate(cube: ObjectModel, stated: Hypothesis) -> None:
    worlds = [with_effect(cube, "gravity", [9.81 - 0.04 * k]) for k in range(20)]
    found = over_order(*beside_nothing(cube, tosses_of(cube, worlds), stated))
    (change,) = found.changes
    assert (change.effect.name, change.form) == ("gravity", "drift")
    rate = change.rate["g_ms2"]
    assert rate.low - 0.003 < -0.04 < rate.high + 0.003
    assert rate.value == pytest.approx(-0.04, abs=0.004)
    first, last = (stretch.values["g_ms2"].value for stretch in change.stretches)
    assert (first, last) == pytest.approx((9.81, 9.05), abs=0.06)


def test_nothing_changes_where_an_effect_is_in_all_tosses(cube: ObjectModel, stated: Hypothesis) -> None:
    found = over_order(*beside_nothing(cube, tosses_of(cube, [with_effect(cube, "friction", [0.26])] * 16), stated))
    assert found.changes == ()
    assert found.left is not None
    assert found.left > 0.005


def test_few_tosses_say_nothing(cube: ObjectModel, stated: Hypothesis, cleaned: list[Toss]) -> None:
    assert over_order(*beside_nothing(cube, cleaned[5:14], stated)) == OverOrder((), None, None)
