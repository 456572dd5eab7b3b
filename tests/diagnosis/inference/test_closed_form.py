"""Sums over tosses give what refitting would, and screening by them is as rare by chance as it states."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.inference import designs
from tossid.diagnosis.inference.columns import Columns
from tossid.diagnosis.inference.designs import change_p_values, designed, line_over, steps_at
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.screening import Score, adjusted_p_values, screen
from tossid.physics.effects import effects_for

Linear = tuple[Columns, np.ndarray, np.ndarray]
"""Columns of a linear model, its design (n, m, width) and residuals (n, m)."""


@pytest.fixture
def linear() -> Linear:
    """With noise of variance one."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(12, 40, 3)) * [1.0, 0.2, 3.0]
    e = rng.normal(size=(12, 40)) - J @ [0.5, 0.0, 0.1]
    return Columns(np.einsum("nmi,nmj->nij", J, J), np.einsum("nmi,nm->ni", J, e), 1.0), J, e


def test_steps_are_least_squares_of_all_tosses_of_drawn_ones_and_of_all_but_one(linear: Linear) -> None:
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


def test_effective_scores_and_information_are_those_of_a_fit_of_the_others(linear: Linear) -> None:
    columns, J, e = linear
    scores, information = columns.scores(np.array([0]), np.array([1, 2]))
    others = J[..., 1:].reshape(-1, 2)
    own = J[..., 0].ravel() - others @ np.linalg.lstsq(others, J[..., 0].ravel())[0]
    assert information[0, 0] == pytest.approx(own @ own, rel=1e-6)
    assert scores.sum() == pytest.approx(own @ e.ravel(), rel=1e-6)


def test_a_step_in_some_columns_gains_as_much_as_if_the_others_followed(linear: Linear) -> None:
    columns, J, e = linear
    moved = e.ravel() + 0.7 * J[..., 0].ravel()
    others = J[..., 1:].reshape(-1, 2)
    left = moved - others @ np.linalg.lstsq(others, moved)[0]
    gain = columns.gain_of_step([0], np.array([0.7]), [1, 2])
    assert gain == pytest.approx(0.5 * ((e**2).sum() - (left**2).sum()), rel=1e-6)


def test_scaled_columns_have_the_covariance_of_scaled_derivatives(linear: Linear) -> None:
    columns, scaled = linear[0], linear[0].scaled(np.full(3, 0.25))
    assert scaled.step() == pytest.approx(4 * columns.step(), rel=1e-6)
    assert scaled.covariance() == pytest.approx(16 * columns.covariance(), rel=1e-6)
    assert scaled.gains(scaled.step()) == pytest.approx(columns.gains(columns.step()), rel=1e-6)


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


NO = np.zeros(0, dtype=int)


def simulated(values: np.ndarray, *, seed: int, scatter: float = 0.0, width: int = 3) -> Linear:
    """Tosses whose first column has these values; they differ in information, and scatter in all columns."""
    rng, n = np.random.default_rng(seed), len(values)
    J = rng.normal(size=(n, 30, width)) * rng.lognormal(0, 0.7, size=(n, 1, 1))
    own = scatter * rng.standard_t(4, size=(n, width))
    own[:, 0] += values
    e = rng.normal(size=(n, 30)) - np.einsum("nmi,ni->nm", J, own)
    return Columns(np.einsum("nmi,nmj->nij", J, J), np.einsum("nmi,nm->ni", J, e), 1.0), J, e


def test_steps_of_a_design_are_least_squares_beside_the_active_columns() -> None:
    columns, J, e = simulated(np.repeat([0.0, 2.0], [9, 11]), seed=0)
    some = designed(columns, np.array([1]), (np.array([0, 2]), steps_at((0, 9, 20))))
    late = (np.arange(20) >= 9)[:, None, None]
    X = np.concatenate([J[..., [1]], J[..., [0, 2]] * ~late, J[..., [0, 2]] * late], axis=-1)
    assert some.step() == pytest.approx(np.linalg.lstsq(X.reshape(-1, 5), -e.ravel())[0], rel=1e-6)
    assert some.step()[[1, 3]] == pytest.approx([0.0, 2.0], abs=0.3)
    line = designed(columns, NO, (np.array([0]), line_over(20))).step()
    X = np.stack([J[..., 0], J[..., 0] * (np.arange(20) - 9.5)[:, None]], axis=-1)
    assert line == pytest.approx(np.linalg.lstsq(X.reshape(-1, 2), -e.ravel())[0], rel=1e-6)


def test_chance_is_as_rare_as_stated_whatever_is_the_same_in_all_tosses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(designs, "ORDERS", 199)
    small = 0
    for seed in range(120):
        columns, _, _ = simulated(np.full(24, 3.0), seed=seed, scatter=0.5, width=4)
        effects = [[(columns, NO, np.array([k]))] for k in range(3)] + [[(columns, np.array([0]), np.array([1, 3]))]]
        small += change_p_values(effects, (12,), seed)[0].min() <= 0.05
    assert small / 120 < 0.11  # 0.05, and three standard errors


def test_a_known_boundary_shows_what_a_search_of_all_places_does_not() -> None:
    clearer = 0
    for seed in range(30):
        columns, _, _ = simulated(np.repeat([0.0, 0.5], [12, 12]), seed=seed, scatter=0.3)
        effects = [[(columns, NO, np.array([0]))]]
        clearer += int(change_p_values(effects, (12,), 0)[0][0] < change_p_values(effects, (), 0)[0][0])
    assert clearer > 18


# ---------------------------------------------------------------- screening


def test_the_effect_that_is_there_gains_most_and_is_significant(slippery: Sample, stated: Hypothesis) -> None:
    library = effects_for(stated.base.object)
    found = screen(slippery.evidence(stated), library, n=slippery.n, rng=np.random.default_rng(0))
    first = found.candidates[0]
    # what contains friction may gain as much
    assert "friction" in (first.name, *EFFECTS[first.name].contains)
    friction = next(c for c in found.candidates if c.name == "friction")
    assert friction.p_value < 0.025
    assert friction.total > 50
    assert [effect.name for effect, _ in found.together(1, 3.0)] == [first.name]
    gravity = next(c for c in found.candidates if c.name == "gravity")
    assert gravity.total < 3


def test_another_law_of_contact_is_a_candidate(slippery: Sample, stated: Hypothesis) -> None:
    laws = (ContactLaw(), ContactLaw("relaxed", lifting=1e-4))
    found = screen(slippery.evidence(stated), (), n=slippery.n, laws=laws, rng=np.random.default_rng(0))
    assert [c.name for c in found.candidates] == ["relaxed"]
    assert found.candidates[0].start.law.name == "relaxed"


def test_effects_are_chosen_together_beside_those_that_are_there(slippery: Sample, stated: Hypothesis) -> None:
    """Also where a special case of one makes room for it."""
    made = slippery.evaluated(slippery.evidence(stated.plus(EFFECTS["gravity"], np.array([9.7]))))
    h = made.hypothesis.plus(EFFECTS["friction"])
    near = made.evidence.relinearised(h)
    others = [EFFECTS[name] for name in ("gravity", "anisotropic_friction", "restitution")]
    found = screen(near, others, n=slippery.n, free=(1,), rng=np.random.default_rng(0))
    chosen = found.together(3, -1e9)
    assert {effect.name for effect, _ in chosen} == {"anisotropic_friction", "restitution"}
    general = next(c for c in found.candidates if c.name == "anisotropic_friction")
    assert general.start.names == ("gravity", "anisotropic_friction")
    assert general.start.values_of("gravity").tolist() == [9.7]


def test_what_could_take_an_effects_place_is_found_in_closed_form(slippery: Sample, stated: Hypothesis) -> None:
    h = stated.plus(EFFECTS["friction"])
    made = slippery.refitted(slippery.evidence(stated), h, iterations=6, follow=1)
    others = [EFFECTS[name] for name in ("gravity", "anisotropic_friction")]
    found = screen(made.evidence, others, n=slippery.n, free=made.free, rng=np.random.default_rng(0))
    shares = {
        c.name: share for share, c in found.replacements(made.columns_of("friction"), made.from_nominal("friction"))
    }
    assert shares["anisotropic_friction"] > 0.8
    assert shares["gravity"] < 0.1


def test_chance_is_as_rare_as_stated_however_alike_and_uneven_tosses_are() -> None:
    rng, small = np.random.default_rng(4), 0
    for _ in range(150):
        size = rng.lognormal(0, 1.0, size=(12, 1))
        common = rng.standard_t(4, size=(12, 1)) * size
        scores = [common + rng.standard_t(4, size=(12, 1 + k % 3)) * size for k in range(8)]
        group = [[Score(u, u.T @ u, False)] for u in scores]
        small += min(adjusted_p_values(group, rng, flips=999)) < 0.05
    assert small / 150 < 0.105  # 0.05, and three standard errors


def test_a_start_counts_forward_only() -> None:
    u = np.full((12, 1), 2.0)
    away, towards = (
        adjusted_p_values([[Score(sign * u, u.T @ u, True)]], np.random.default_rng(0)) for sign in (1, -1)
    )
    assert away == [1.0]
    assert towards[0] < 0.01
