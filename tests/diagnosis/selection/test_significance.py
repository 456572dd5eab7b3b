"""Signed ranks over tosses, in parts, and how many tosses a name needs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import rankdata, wilcoxon

from tossid.diagnosis.selection.significance import (
    PARTS,
    TossesNeeded,
    fewest_tosses,
    part_p_value,
    signed_rank_p_value,
)
from tossid.physics.effects import LIBRARY
from tossid.types import Phase


def test_evidence_in_one_part_is_seen_beside_noise_in_the_other() -> None:
    rng = np.random.default_rng(0)
    quiet, loud = rng.normal(2, 1, 30), rng.normal(-5, 50, 30)
    parts = np.stack([quiet + loud, loud, quiet])
    assert part_p_value(parts[:1]) > 0.05
    assert part_p_value(parts) < 1e-5


def test_nothing_shows_nowhere_too_seldom() -> None:
    """Under the null, p below 0.05 in at most 5 % (four standard errors of 400)."""
    rng = np.random.default_rng(1)
    low = sum(part_p_value(rng.normal(size=(3, 25)) * [[1], [3], [10]]) < 0.05 for _ in range(400))
    assert low <= 400 * 0.05 + 4 * np.sqrt(400 * 0.05 * 0.95)


def test_signed_ranks_ignore_one_outlier() -> None:
    assert signed_rank_p_value(np.arange(1.0, 13.0)) == pytest.approx(2.0**-12)
    assert signed_rank_p_value(np.append(np.arange(1.0, 13.0), -1e6)) < 0.1
    assert signed_rank_p_value(np.array([-1.0, 1.1, -0.9, 0.8])) > 0.4
    assert signed_rank_p_value(np.array([1.0, 2.0])) == 1.0


@pytest.mark.parametrize("n", [4, 9, 12])
def test_ranks_with_ties_and_zeros_are_tested_by_all_choices_of_signs(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(5):
        values = rng.integers(-2, 5, n).astype(float)
        signs = np.array(list(itertools.product([-1.0, 1.0], repeat=n)))
        kept = values[values != 0]
        ranks = np.where(values != 0, rankdata(np.where(values != 0, np.abs(values), np.inf)), 0.0)
        sums = np.where(signs > 0, ranks, 0.0).sum(1)
        expected = (sums >= ranks[values > 0].sum() - 1e-9).mean()
        assert signed_rank_p_value(values) == pytest.approx(expected if len(kept) else 1.0)


def test_ranks_without_ties_are_as_scipy_has_them() -> None:
    for n in (5, 20, 50, 80):
        values = np.random.default_rng(n).normal(0.3, 1, n)
        expected = wilcoxon(values, alternative="greater").pvalue
        assert signed_rank_p_value(values) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("effects", "tests", "needed"), [(29, 3, 11), (35, 3, 12), (29, 1, 10), (1, 1, 5), (2, 3, 7)])
def test_tosses_that_a_name_needs(effects: int, tests: int, needed: int) -> None:
    assert fewest_tosses(0.05, tests=tests, effects=effects) == needed


@pytest.mark.parametrize("effects", [1, 2, 7, 18, 29, 35])
@pytest.mark.parametrize("tests", [1, PARTS])
def test_with_so_many_the_best_case_is_significant_and_with_one_less_it_is_not(effects: int, tests: int) -> None:
    """By the test itself, of gains that are all positive."""
    n = fewest_tosses(0.05, tests=tests, effects=effects)
    gains = np.tile(np.arange(1.0, n + 1), (tests, 1))
    assert part_p_value(gains) < 0.05 / effects
    assert part_p_value(gains[:, 1:]) >= 0.05 / effects


def test_flight_alone_needs_fewer() -> None:
    needed = TossesNeeded.of(LIBRARY, 0.05, tosses=9, flights=9)
    flying = sum(Phase.FLIGHT in effect.phases for effect in LIBRARY)
    assert needed.flight == fewest_tosses(0.05, tests=1, effects=flying) < needed.contact
    assert not needed.enough
    assert needed.as_json()["for_a_name"] == needed.contact
