"""The part of windows before contact, and that it determines first states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.until_contact import FEWEST_FRAMES, until_contact
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Phase


def test_only_frames_before_contact_are_left(cube: ObjectModel) -> None:
    windows = make_windows(seen(World(cube), cube, 6, seed=2, frames=70), cube)
    index, part = until_contact(windows)
    assert len(index) > 0
    for w, steps, inside in zip(index, part.steps, part.inside, strict=True):
        assert steps >= FEWEST_FRAMES
        assert inside.sum() == steps < windows.inside[w].sum()
        assert (windows.phase[w, :steps] == Phase.FLIGHT).all()
        assert (windows.phase[w][windows.inside[w]] != Phase.FLIGHT).any()
    residuals = part.residuals(part.predicted(World(cube)))
    assert (residuals[~part.inside] == 0.0).all()


def test_flight_determines_first_states(cube: ObjectModel) -> None:
    world, noise = World(cube), np.random.default_rng(0)
    tosses = seen(world, cube, 12, seed=3, frames=70)
    windows = make_windows(tosses, cube)
    index, part = until_contact(windows)
    off = noise.normal(size=part.v.shape) * np.array([0.15] * 3 + [2.0] * 3)
    found, _ = linearise(replace(part, at_v=part.v + off), world, refine=6)
    at, _ = linearise(windows.rows(index), world, refine=6, restarts=3)
    # whole windows determine velocities too, where their impacts are those that were seen
    apart = np.abs(found.at_v - at.at_v)
    assert np.median(apart[:, :3]) < 0.01
    assert np.median(apart[:, 3:]) < 0.1
    assert np.abs(off[:, 3:]).mean() > 1.0
