"""A corner that is wrong has the gap, and shares of corners add up."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import gap, with_place
from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Gap
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.corners import corner_shares
from tossid.diagnosis.localisation.gap import measure_gap
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel, corner_positions
from tossid.physics.effects import World
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Phase


def contact_gap(nominal: ObjectModel, wrong: int, *, n: int = 12) -> tuple[list, Gap]:
    """Tosses whose excess is 2 in contact while corner `wrong` is the lowest, else 0.2; 5 in flight."""
    tosses = seen(World(nominal), nominal, n, seed=4)
    rows = []
    for i, toss in enumerate(tosses):
        lowest = corner_positions(nominal, toss.q)[..., 2].argmin(1)
        for k in range(1, len(toss)):
            excess = 5.0 if toss.phase[k] == Phase.FLIGHT else 2.0 if lowest[k] == wrong else 0.2
            rows.append((i, k * (toss.t[1] - toss.t[0]), toss.phase[k], excess))
    return tosses, replace(gap(2.0, n=n), frames=np.array(rows))


def test_shares_of_corners_add_up(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    shares = corner_shares(tosses, World(cube), made, 1 / 148)
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)
    np.testing.assert_allclose([c.place for c in shares], cube.corner_pos)
    touching = sum(int((toss.phase[1:] != Phase.FLIGHT).sum()) for toss in tosses)
    assert touching <= sum(c.frames for c in shares) <= 4 * touching
    assert max(range(8), key=lambda c: shares[c].per_frame or 0.0) == 3
    half = replace(made, frames=made.frames * [1, 1, 1, 0.5])
    left = corner_shares(tosses, World(cube), half, 1 / 148, whole=made)
    assert sum(c.share.value for c in left) == pytest.approx(0.5)


def test_no_gap_in_contact_is_not_shared_out(cube: ObjectModel) -> None:
    tosses, made = contact_gap(cube, 3)
    noise = made.frames.copy()
    noise[:, 3] = np.where(noise[:, 2] == Phase.FLIGHT, 5.0, np.random.default_rng(0).normal(size=len(noise)))
    assert corner_shares(tosses, World(cube), replace(made, frames=noise), 1 / 148) == ()


def test_a_wrong_corner_has_the_gap(cube: ObjectModel) -> None:
    wrong, n = 5, 12
    places = cube.corner_pos.copy()
    places[wrong] *= 0.95
    tosses = seen(World(cube.with_changes(corner_pos=places)), cube, n, seed=2)
    settings = changed(DiagnoseSettings(), {"other_lengths": ()})
    judge = CrossValidator.of(tosses, cube, seed=0, settings=settings)
    first = judge.evaluate(Hypothesis(World(cube)))
    measured = measure_gap(tosses, first, judge, noise_floor(judge.windows))
    shares = corner_shares(tosses, World(cube), measured, 1 / 148)
    assert shares[wrong].share.value > 0.6
    assert shares[wrong].share.low > 0.4
    assert sum(c.share.value for c in shares) == pytest.approx(1.0)


def test_gap_json_says_where(cube: ObjectModel) -> None:
    made = json.loads(json.dumps(with_place(cube).as_json(), allow_nan=False))
    corner = made["gap"]["by_corner"][0]
    assert set(corner) >= {"corner", "share", "ci95", "frames"}
    relation = made["gap"]["wrench"][0]
    assert (relation["component"], relation["state"]) == ("force_along", "horizontal_speed")
    assert relation["clear"] is True
    assert relation["r2"]["ci95"][0] <= relation["r2"]["value"]
    assert len(made["gap_left"]["by_corner"]) == 8
