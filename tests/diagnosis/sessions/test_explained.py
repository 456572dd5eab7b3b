"""A diagnosis of two recordings names what differs between them, by session, and explains the gap."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.sessions.test_looking import FEW, tilted_from
from tests.diagnosis.tossed import seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.report.text import headline, sentences
from tossid.diagnosis.sessions.explained import excess_of_tosses, explain_over_order
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.mark.slow
def test_two_recordings_are_told_apart(cube: ObjectModel) -> None:
    explained = explain_over_order(Problem(tilted_from(cube, 9, 20), World(cube), library=FEW))
    found = explained.diagnosis
    assert found.named == ("world_tilt",)
    assert found.verdict == "explained"
    assert found.gap_closed.value > 0.7
    entry = found.as_json()["effects"][0]
    assert entry["name"] == "world_tilt"
    first, second = entry["sessions"]
    assert (first["first"], second["last"]) == ("0", "19")
    assert abs(int(second["first"]) - 9) <= 1
    assert second["parameters"]["x_rad"]["value"] == pytest.approx(0.012, abs=1e-3)
    assert found.as_json()["changes_left"] == []
    assert "changes" in headline(found)
    assert any(text.startswith("Two recordings: tosses 0 to ") for text in sentences(found))
    assert excess_of_tosses(found.gap, 20)[10:].mean() > 5 * excess_of_tosses(found.left, 20)[10:].mean()
    assert found.steps[0].position_error_pct.value > found.steps[-1].position_error_pct.value


def test_few_tosses_are_explained_as_before(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 6, seed=3, frames=40)
    plain = explain(Problem(tosses, World(cube), library=FEW))
    found = explain_over_order(Problem(tosses, World(cube), library=FEW)).diagnosis
    assert found.changes_left is None
    assert found.gap.total == plain.gap.total
    assert found.tosses == tuple(toss.name for toss in tosses)
    np.testing.assert_array_equal(found.places, [toss.q[-1, :2] for toss in tosses])
