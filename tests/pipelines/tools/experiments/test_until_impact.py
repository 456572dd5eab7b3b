"""Tosses until their second impact: how long that is, and what a right world predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipelines.tools.experiments.until_impact import errors, frames_until_second_impact
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Phase


def test_the_second_impact_ends_a_prediction(cube: ObjectModel) -> None:
    (toss,) = seen(World(cube), cube, 1, seed=1, frames=40)
    phase = np.full(41, Phase.FLIGHT, np.uint8)
    phase[10:13] = phase[20:] = Phase.IMPACT
    assert frames_until_second_impact(replace(toss, phase=phase)) == 20
    phase[20:] = Phase.FLIGHT
    assert frames_until_second_impact(replace(toss, phase=phase)) == 41


def test_the_right_friction_predicts_better(cube: ObjectModel) -> None:
    right = World(cube.with_changes(friction=0.4))
    tosses = seen(right, cube, 6, seed=3, frames=60)
    stated, found = (np.median(errors(tosses, world), axis=0) for world in (World(cube), right))
    assert (found < 0.5 * stated).all()


def test_frames_that_a_recording_lost_are_no_error_of_the_prediction(cube: ObjectModel) -> None:
    world = World(cube)
    tosses = seen(world, cube, 6, seed=3, frames=60)
    kept = np.setdiff1d(np.arange(61), [30, 31])
    by_frame = ("t", "q", "v", "q_cov", "v_cov", "phase")
    lossy = [replace(toss, **{name: getattr(toss, name)[kept] for name in by_frame}) for toss in tosses]
    np.testing.assert_allclose(errors(lossy, world), errors(tosses, world), rtol=0.2)
