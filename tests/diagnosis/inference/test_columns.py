"""Sums over tosses give what refitting would: steps, tosses left out, gains, effective scores, covariances."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.inference.columns import Columns


@pytest.fixture
def linear() -> tuple[Columns, np.ndarray, np.ndarray]:
    """Columns of a linear model with noise of variance one, with its design (n, m, 3) and residuals (n, m)."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(12, 40, 3)) * [1.0, 0.2, 3.0]
    e = rng.normal(size=(12, 40)) - J @ [0.5, 0.0, 0.1]
    return Columns(np.einsum("nmi,nmj->nij", J, J), np.einsum("nmi,nm->ni", J, e), 1.0), J, e


def test_steps_are_least_squares_of_all_tosses_of_drawn_ones_and_of_all_but_one(
    linear: tuple[Columns, np.ndarray, np.ndarray],
) -> None:
    columns, J, e = linear

    def solved(tosses: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(J[tosses].reshape(-1, 3), -e[tosses].ravel())[0]

    assert columns.step() == pytest.approx(solved(np.arange(12)), rel=1e-6)
    drawn = np.random.default_rng(1).integers(0, 12, 12)
    assert columns.step(np.bincount(drawn, minlength=12).astype(float)) == pytest.approx(solved(drawn), rel=1e-6)
    out = columns.left_out()
    assert out[4] == pytest.approx(solved(np.delete(np.arange(12), 4)), rel=1e-6)
    gain = 0.5 * ((e**2).sum(1) - ((e + np.einsum("nmi,ni->nm", J, out)) ** 2).sum(1))
    assert columns.gains(out) == pytest.approx(gain, rel=1e-6)


def test_effective_scores_and_information_are_those_of_a_fit_of_the_others(
    linear: tuple[Columns, np.ndarray, np.ndarray],
) -> None:
    columns, J, e = linear
    scores, information = columns.scores(np.array([0]), np.array([1, 2]))
    others = J[..., 1:].reshape(-1, 2)
    own = J[..., 0].ravel() - others @ np.linalg.lstsq(others, J[..., 0].ravel())[0]
    assert information[0, 0] == pytest.approx(own @ own, rel=1e-6)
    assert scores.sum() == pytest.approx(own @ e.ravel(), rel=1e-6)


def test_a_step_in_some_columns_gains_as_much_as_if_the_others_followed(
    linear: tuple[Columns, np.ndarray, np.ndarray],
) -> None:
    columns, J, e = linear
    moved = e.ravel() + 0.7 * J[..., 0].ravel()
    others = J[..., 1:].reshape(-1, 2)
    left = moved - others @ np.linalg.lstsq(others, moved)[0]
    gain = columns.gain_beside([0], np.array([0.7]), [1, 2])
    assert gain == pytest.approx(0.5 * ((e**2).sum() - (left**2).sum()), rel=1e-6)


def test_intervals_over_tosses_cover_the_truth() -> None:
    rng, hits = np.random.default_rng(2), 0
    for _ in range(300):
        J = rng.normal(size=(20, 30, 1)) * rng.lognormal(0, 0.7, size=(20, 1, 1))
        # each toss has a value of its own, so that noise alone gives intervals that are too narrow
        e = rng.normal(size=(20, 30)) - J[..., 0] * (1.0 + 0.3 * rng.normal(size=(20, 1)))
        at = Columns(np.einsum("nmi,nmj->nij", J, J), np.einsum("nmi,nm->ni", J, e), 1.0)
        step = at.step()
        there = Columns(at.H, at.g + at.H @ step, 1.0)
        hits += bool(abs(step[0] - 1.0) < 2.09 * np.sqrt(there.covariance()[0, 0]))
    assert 0.90 < hits / 300 < 0.985
