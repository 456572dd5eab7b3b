"""The next toss is feasible, and separates what it is to separate, by as much as a fit would see."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.tossed import sample_of, seen
from tossid.diagnosis.likelihood.step_changes import State
from tossid.diagnosis.next_toss import draw_releases, next_toss, separations
from tossid.motion import lowest_corner
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss

FRAMES = 41


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube), cube, 8, seed=1, frames=FRAMES - 1)


def test_releases_are_feasible(cube: ObjectModel, tosses: list[Toss]) -> None:
    drawn = draw_releases(tosses, cube, 300, rng=np.random.default_rng(0))
    first = lowest_corner(cube, np.stack([toss.q[0] for toss in tosses]))
    low, high = first.min(), first.max()
    heights = lowest_corner(cube, drawn.q)
    room = 0.25 * (high - low) + 1e-9
    assert heights.min() >= max(low - room, 0.02) - 1e-9
    assert heights.max() <= high + room
    assert heights.max() > high  # wider than what was seen
    np.testing.assert_allclose(np.linalg.norm(drawn.q[:, 3:], axis=1), 1, atol=1e-12)


def test_alike_hypotheses_are_not_separated(cube: ObjectModel, tosses: list[Toss]) -> None:
    one = hypothesis(cube, friction=[0.3])
    drawn = draw_releases(tosses, cube, 5, rng=np.random.default_rng(0))
    np.testing.assert_allclose(separations([one, one], drawn, tosses, 30, sample_of(tosses, cube)), 0, atol=1e-6)
    found = next_toss(one, [one], tosses, sample_of(tosses, cube), rng=np.random.default_rng(0))
    assert found["release"] is None
    assert "none of 200 feasible releases" in found["reason"]
    alone = next_toss(one, [], tosses, sample_of(tosses, cube), rng=np.random.default_rng(0))
    assert alone["release"] is None
    assert "no two effects are confusable" in alone["reason"]


def test_magnus_shows_with_spin_across_the_velocity_only(cube: ObjectModel, tosses: list[Toss]) -> None:
    rivals = [hypothesis(cube), hypothesis(cube, magnus=[0.02])]
    q = np.tile([0.0, 0.0, 1.5, 1.0, 0.0, 0.0, 0.0], (3, 1))
    v = np.zeros((3, 6))
    v[1, 3], v[2, 5] = 20.0, 20.0  # it falls: spin about a horizontal axis is across, about the vertical along
    still, across, along = separations(rivals, State(q, v), tosses, 60, sample_of(tosses, cube))
    assert across > 10
    assert along < 1e-3 * across
    assert still < 1e-6


def test_a_separation_is_what_a_fit_would_see(cube: ObjectModel, tosses: list[Toss]) -> None:
    """A uniform force in flight: deviations c_k = a t_k² / 2 with first state unknown, whitened by hand."""
    force, n, dt, sigma = 0.002, 20, 1 / 148, 1.5e-4
    rivals = [hypothesis(cube), hypothesis(cube, uniform_force=[force, 0.0, 0.0])]
    q = np.array([[0.0, 0.0, 1.5, 1.0, 0.0, 0.0, 0.0]])
    found = float(separations(rivals, State(q, np.zeros((1, 6))), tosses, n, sample_of(tosses, cube))[0])
    t = dt * np.arange(1, n + 1)
    c = 0.5 * force / 0.37 * t**2
    S = np.stack([np.ones(n), t], axis=1)
    cov = sigma**2 * np.eye(n) + S @ np.diag([sigma**2, 0.5**2]) @ S.T
    expected = float(np.sqrt(c @ np.linalg.solve(cov, c)))
    assert found == pytest.approx(expected, rel=0.05)


def test_the_best_release_beats_a_usual_toss(cube: ObjectModel, tosses: list[Toss]) -> None:
    one, other = hypothesis(cube, friction=[0.3]), hypothesis(cube, velocity_friction=[0.33, 0.28, 0.3])
    found = next_toss(one, [other], tosses, sample_of(tosses, cube), rng=np.random.default_rng(0))
    assert found["between"] == ["friction", "velocity_friction"]
    assert found["separation_sd"] > 1.5 * found["separation_of_tosses_seen_sd"]
    both = [rival.plus(EFFECTS["gravity"]) for rival in (one, other)]
    named = next_toss(both[0], both[1:], tosses[:6], sample_of(tosses[:6], cube), rng=np.random.default_rng(0))[
        "between"
    ]
    assert named == ["friction", "velocity_friction"]  # what both have is not said
    release = found["release"]
    again = State(
        np.array([release["position_m"] + release["attitude_wxyz"]]),
        np.array([release["velocity_ms"] + release["spin_body_rads"]]),
    )
    np.testing.assert_allclose(
        separations([one, other], again, tosses, FRAMES - 1, sample_of(tosses, cube)), found["separation_sd"], rtol=1e-6
    )
