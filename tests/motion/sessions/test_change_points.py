"""Changes over an order: found where they are, and not where the order means nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tossid.motion.sessions.change_points import (
    changes_at,
    fewest_items,
    find_changes,
    robust_mean,
    split_statistics,
)
from tossid.settings.sessions import SessionSettings

Array = np.ndarray


def witness(values: Array, *, places: Array | None = None) -> tuple[Array, Array, Array]:
    n, d = values.shape
    return values, np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, 2)) if places is None else places


def test_a_shift_is_found_within_three_items() -> None:
    near = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = rng.normal(size=(60, 2))
        at = int(rng.integers(12, 48))
        values[at:] += [2.0, 1.0]  # two standard deviations
        changes = find_changes({"tilt": witness(values), "noise": witness(rng.normal(size=(60, 1)))})
        near += [abs(change.at - at) <= 3 for change in changes] == [True]
    assert near >= 19


@pytest.mark.parametrize("draw", ["normal", "heavy tails", "few values"])
def test_no_change_is_found_in_an_order_that_means_nothing(draw: str) -> None:
    found = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = {
            "normal": rng.normal(size=(50, 2)),
            "heavy tails": rng.standard_t(1.2, size=(50, 2)),
            "few values": (rng.random(size=(50, 1)) < 0.1).astype(float),
        }[draw]
        found += bool(find_changes({"a": witness(values), "b": witness(rng.normal(size=(50, 1)))}))
    assert found <= 1


def test_a_change_at_a_known_place_takes_less() -> None:
    settings = SessionSettings(significance=0.005, permutations=1999)
    known = searched = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        values = rng.normal(size=(24, 2))
        values[11:] += [1.9, 0.0]
        some = {"tilt": witness(values)} | {f"{i}": witness(rng.normal(size=(24, 1))) for i in range(30)}
        known += "tilt" in changes_at(some, 11, settings=replace(settings, permutations=19999))
        searched += bool(find_changes(some, settings=settings))
    assert known >= 5
    assert searched <= 1


def test_many_witnesses_seldom_change_by_chance_at_a_place() -> None:
    settings, alone, together = SessionSettings(significance=0.05, permutations=499), 0, 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        common = rng.normal(size=(30, 2))
        some = {f"{i}": witness(0.5 * common + rng.standard_t(2, size=(30, 2))) for i in range(10)}
        together += bool(changes_at(some, 12, settings=settings))
        alone += any(changes_at({name: one}, 12, settings=settings) for name, one in some.items())
    assert together <= 2
    assert alone >= 5


def test_each_witness_is_tested_by_itself_where_anything_changes() -> None:
    rng = np.random.default_rng(0)
    some = {f"{i}": witness(rng.standard_t(2, size=(30, 2))) for i in range(100)}
    settings = SessionSettings(significance=0.1, permutations=9999)
    clear = {"clear": witness(rng.normal(size=(30, 1)) + 3.0 * (np.arange(30) >= 12)[:, None])}
    found = changes_at({**some, **clear}, 12, settings=settings)
    assert found.pop("clear") <= 2e-4
    assert len(found) == pytest.approx(10, abs=9)
    assert max(found.values()) <= 0.1


def test_two_changes_are_found() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(90, 1))
    values[30:60] += 3
    assert [change.at for change in find_changes({"height": witness(values)})] == pytest.approx([30, 60], abs=2)


def test_what_place_explains_is_no_change() -> None:
    rng = np.random.default_rng(5)
    places = rng.normal(size=(80, 2))
    places[:20, 0] += 3  # the first tosses land elsewhere
    values = places @ np.array([[1.0, 0.2], [0.3, -1.0]]) + 0.1 * rng.normal(size=(80, 2))
    assert not find_changes({"normal": witness(values, places=places)})
    assert find_changes({"normal": witness(values)})


def test_items_that_say_nothing_are_passed_over() -> None:
    rng = np.random.default_rng(7)
    values, info, places = witness(rng.normal(size=(60, 1)))
    values[30:] += 4
    values[::3], info[::3] = np.nan, 0
    (change,) = find_changes({"fall": (values, info, places)})
    assert abs(change.at - 30) <= 3


def test_items_that_say_less_of_themselves_by_a_change_are_not_outweighed() -> None:
    rng = np.random.default_rng(11)
    values, info, places = witness(rng.normal(size=(40, 1)))
    values[32:] = -100 + 10 * rng.normal(size=(8, 1))
    info[32:] /= 10**2
    (change,) = find_changes({"height": (values, info, places)})
    assert change.at == 32


def test_the_robust_mean_of_clean_items_is_the_mean_and_outliers_hardly_move_it() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(loc=(5.0, -3.0), size=(400, 2))
    info = np.tile(np.eye(2), (400, 1, 1))
    mean = robust_mean(values, info)
    assert mean.value == pytest.approx(values.mean(axis=0), abs=0.02)
    assert np.sqrt(np.diag(mean.cov)) == pytest.approx(1 / 20, rel=0.15)
    values[:20] += 1000
    assert robust_mean(values, info).value == pytest.approx([5.0, -3.0], abs=0.25)


def test_the_statistic_is_that_of_two_means() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=20)
    k = np.arange(5, 16)
    between = np.array([(x[:i].mean() - x[i:].mean()) ** 2 * i * (20 - i) / 20 for i in k])
    assert split_statistics(x[:, None], 5) == pytest.approx(between / x.var())


def test_too_few_items_are_not_judged() -> None:
    settings = SessionSettings()
    least = fewest_items(1, settings)
    values = np.concatenate([np.zeros(least // 2), np.ones(least - least // 2)])[:, None] * 100
    noise = np.random.default_rng(0).normal(size=(least, 1))
    assert find_changes({"height": witness(values + noise)})
    assert not find_changes({"height": witness((values + noise)[:-2])})
