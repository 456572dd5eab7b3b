"""A corner that is wrong has the gap, and shares of corners add up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.evidence import collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.corners import corner_shares, place_of
from tossid.diagnosis.localisation.gap import Rows
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import World, effect_named
from tossid.types import Phase, Toss


def contact_gap(nominal: ObjectModel, wrong: int, *, n: int = 12) -> tuple[list[Toss], Rows]:
    """Tosses whose excess is 2 in contact while corner `wrong` is the lowest, else 0.2; 5 in flight."""
    tosses = seen(World(nominal), nominal, n, seed=4)
    rows = []
    for i, toss in enumerate(tosses):
        lowest = corner_positions(nominal, toss.q)[..., 2].argmin(1)
        for k in range(1, len(toss)):
            excess = 5.0 if toss.phase[k] == Phase.FLIGHT else 2.0 if lowest[k] == wrong else 0.2
            rows.append((i, k * (toss.t[1] - toss.t[0]), toss.phase[k], excess))
    number, time, phase, excess = np.array(rows).T
    none = np.zeros((len(rows), 1))
    flags = np.zeros(len(rows), dtype=bool)
    made = Rows(number.astype(int), time, phase.astype(np.uint8), flags, none, none, excess[:, None], n)
    return tosses, made


def test_shares_of_corners_add_up(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    shares = corner_shares(tosses, World(cube), made, 1 / 148, whole=made)
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)
    np.testing.assert_allclose([c.place for c in shares], cube.corner_pos)
    touching = sum(int((toss.phase[1:] != Phase.FLIGHT).sum()) for toss in tosses)
    assert touching <= sum(c.frames for c in shares) <= 4 * touching
    assert max(range(8), key=lambda c: shares[c].per_frame or 0.0) == 3
    half = replace(made, excess=0.5 * made.excess)
    left = corner_shares(tosses, World(cube), half, 1 / 148, whole=made)
    assert sum(c.share.value for c in left) == pytest.approx(0.5)


def test_no_gap_in_contact_is_not_shared_out(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    drawn = np.random.default_rng(0).normal(size=made.excess.shape)
    noise = replace(made, excess=np.where((made.phase == Phase.FLIGHT)[:, None], 5.0, drawn))
    assert corner_shares(tosses, World(cube), noise, 1 / 148, whole=noise) == ()


def test_a_wrong_corner_has_the_gap(cube: ObjectModel) -> None:
    wrong, n = 5, 12
    places = cube.corner_pos.copy()
    places[wrong] *= 0.95
    tosses = seen(World(cube.with_changes(corner_pos=places)), cube, n, seed=2)
    shares = place_of(tosses, collect(make_windows(tosses, cube), Hypothesis(World(cube))), None, seed=0).corners
    assert shares[wrong].share.value > 0.6
    assert shares[wrong].share.low > 0.4
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)


def test_what_explains_the_gap_leaves_no_wrench_and_little_at_any_corner(cube: ObjectModel) -> None:
    """Without friction's right value a force against the path is missing; with it, none is."""
    tosses = seen(World(cube.with_changes(friction=0.25)), cube, 14, seed=1)
    stated, friction = Hypothesis(World(cube)), effect_named("friction")
    windows = make_windows(tosses, cube)
    before = collect(windows, stated)
    place = place_of(tosses, before, collect(windows, stated.plus(friction, np.array([0.25]))), seed=0)
    contact = next(each for each in place.wrench if each.phase == "contact")
    assert contact.clear
    assert contact.component == "force_along"
    mean, weight = contact.means["force_along"], cube.mass[0] * 9.81
    assert mean.low < -(0.25 - cube.friction) * weight < mean.high
    assert not any(each.clear for each in place.wrench_left)
    assert sum(c.share.value for c in place.corners) == pytest.approx(1.0)
    assert sum(c.share.value for c in place.corners_left) < 0.1
    alone = place_of(tosses, before, None, seed=0)
    assert alone.corners == alone.corners_left == place.corners
