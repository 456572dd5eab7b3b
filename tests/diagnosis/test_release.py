"""First frames that are not free are found over all tosses, and drag is not taken for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.release import bound_frames
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Toss


def held_for(tosses: list[Toss], frames: int, acceleration: float) -> list[Toss]:
    """Tosses whose first frames fall faster by an acceleration, from a first height that is higher for it."""
    out = []
    for toss in tosses:
        left = np.maximum(toss.t[frames] - toss.t, 0.0)
        q = toss.q.copy()
        q[:, 2] -= 0.5 * acceleration * left**2
        out.append(replace(toss, q=q))
    return out


@pytest.mark.parametrize("frames", [0, 1, 3])
def test_frames_that_are_held_are_counted(cube: ObjectModel, frames: int) -> None:
    tosses = held_for(seen(World(cube), cube, 40, seed=1, frames=60), frames, 25.0)
    assert bound_frames(tosses, cube) == frames


def test_drag_holds_no_frame(cube: ObjectModel) -> None:
    world = EFFECTS["quadratic_drag"].at(World(cube), np.array([0.1]))
    assert bound_frames(seen(world, cube, 40, seed=2, frames=60), cube) == 0


def test_few_tosses_show_no_release(cube: ObjectModel) -> None:
    assert bound_frames(held_for(seen(World(cube), cube, 4, seed=1, frames=60), 3, 25.0), cube) == 0
