"""A change of the recording is found and undone, and values of other tosses follow their place in the order."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.sessions.looking import Corrections, TossOrder, undo_changes
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss

FEW = [EFFECTS[name] for name in ("world_tilt", "friction")]


def tilted_from(cube: ObjectModel, at: int, n: int) -> tuple[Toss, ...]:
    """Tosses of which those from one on stand in a tilted world."""
    level = seen(World(cube), cube, at, seed=3, frames=60)
    tilted = seen(with_effect(cube, "world_tilt", [0.012, -0.006]), cube, n - at, seed=4, frames=60)
    return tuple(replace(toss, name=str(i)) for i, toss in enumerate([*level, *tilted]))


def test_a_tilt_is_found_and_undone(cube: ObjectModel) -> None:
    settings = DiagnoseSettings()
    make = partial(CrossValidator.of, seed=0, n_threads=1, engine=None, settings=settings)
    tosses = tilted_from(cube, 9, 20)
    names = [toss.name for toss in tosses]
    # the dataset says that a session begins one toss earlier
    order = TossOrder.of(tosses, (), names, [names[8]])
    first, last, found = undo_changes(Corrections(tosses), World(cube), FEW, order, make, settings)
    ((each, looked),) = found.undone
    assert looked is first
    assert each.effect.name == "world_tilt"
    assert each.edges in ((0, 8, 20), (0, 9, 20))
    np.testing.assert_allclose(each.values[-1], [0.012, -0.006], atol=1e-3)
    assert np.abs(each.values[0]).max() < 2e-3
    assert last.effect is None
    assert last.changes == ()


def test_unseen_tosses_have_the_values_of_their_neighbours(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=1, frames=8)
    tosses = [replace(toss, name=name) for toss, name in zip(tosses, ("0", "2", "4", "3"), strict=True)]
    order = TossOrder.of(tosses[:3], tosses[3:], ("0", "1", "2", "3", "4", "5"), ("4",))
    assert order.boundaries == (2,)
    np.testing.assert_allclose(order.of_unseen(np.array([[0.0], [1.0], [3.0]])), [[2.0]])
