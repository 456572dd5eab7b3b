"""Changes are found where they are, and where nothing changes nothing is found."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.sessions.changes import changes_over_order
from tossid.diagnosis.sessions.moments import moments_of_steps
from tossid.diagnosis.sessions.values import RESIDUAL
from tossid.motion.sessions.change_points import Witness
from tossid.settings.diagnosis.order import OrderSettings

N = 40
SETTINGS = OrderSettings(permutations=1999)


def witness(true: np.ndarray, *, seed: int, sigma: float = 0.2) -> Witness:
    """What tosses say of parameters (n, d), with errors of their own, of which two are far off."""
    rng = np.random.default_rng(seed)
    n, d = true.shape
    values = true + sigma * rng.normal(size=true.shape)
    values[[3, n - 4]] += 4.0
    return values, np.tile(np.eye(d) / sigma**2, (n, 1, 1)), rng.normal(size=(n, 2))


def step(at: int, d: int = 2) -> np.ndarray:
    return np.repeat((np.arange(N) >= at).astype(float)[:, None], d, axis=1)


@pytest.mark.parametrize("at", [8, 20, 31])
def test_a_step_is_found_where_it_is_and_in_nothing_else(at: int) -> None:
    seen = {"tilt": witness(step(at), seed=at), "other": witness(0 * step(at), seed=90 + at)}
    (change,) = changes_over_order(seen, SETTINGS)
    assert abs(change.at - at) <= 3
    (moment,) = moments_of_steps(seen["tilt"], (change.at,), SETTINGS)
    assert abs(moment - at) <= 1
    assert set(change.p) == {"tilt"}


def test_what_depends_on_place_does_not_change() -> None:
    place = np.column_stack([step(20, 1)[:, 0], np.zeros(N)])
    values, info, _ = witness(step(20, 1), seed=1)
    assert changes_over_order({"height": (values, info, place + 1e-3)}, SETTINGS) == ()


def test_a_session_of_the_dataset_is_tested_where_it_begins() -> None:
    seen = {"tilt": witness(1.5 * step(16), seed=11, sigma=1.0)}
    seen |= {f"{k}": witness(0 * step(5), seed=200 + k) for k in range(30)}
    settings = OrderSettings()
    assert changes_over_order(seen, settings) == ()
    (change,) = changes_over_order(seen, settings, boundaries=(16,))
    assert change.at == 16
    assert "tilt" in change.p
    # too near to an end, or to a change that was found
    assert changes_over_order(seen, settings, boundaries=(3, 38)) == ()
    clear = {"tilt": witness(step(16), seed=11)}
    assert len(changes_over_order(clear, SETTINGS, boundaries=(17,))) == 1


def test_effects_are_tested_where_the_size_of_the_gap_changes() -> None:
    """What is too little to be found among many at all places is found where the gap says that something changes."""
    seen = {"tilt": witness(1.5 * step(16), seed=11, sigma=1.0)}
    seen |= {f"{k}": witness(0 * step(5), seed=200 + k) for k in range(30)}
    (change,) = changes_over_order({**seen, RESIDUAL: witness(step(16, 1), seed=3)}, OrderSettings())
    assert change.at == 16
    assert set(change.p) == {"tilt", RESIDUAL}


def test_nothing_is_found_in_nothing() -> None:
    found = [
        changes_over_order({f"{k}": witness(0 * step(5), seed=100 * seed + k) for k in range(8)}, SETTINGS)
        for seed in range(6)
    ]
    assert found == [()] * 6


def test_what_a_toss_does_not_say_does_not_count() -> None:
    values, info, place = witness(step(20), seed=6)
    blind = np.arange(0, N, 3)
    info[blind], values[blind] = 0.0, 1e6
    (change,) = changes_over_order({"tilt": (values, info, place), RESIDUAL: witness(0 * step(5), seed=7)}, SETTINGS)
    assert abs(change.at - 20) <= 2
