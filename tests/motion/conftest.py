"""Tosses that several tests of motion share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.motion import tosses_from_tracks
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.objects import ObjectModel, unstated_object
from tossid.settings.synthesis import ShapeTossSettings
from tossid.synthesis.linked import toss_links
from tossid.synthesis.shapes import toss_shape
from tossid.types import PoseTrack, Toss


@pytest.fixture(scope="package")
def cube_tracks(cube: ObjectModel) -> list[PoseTrack]:
    """Forty tosses of the cube onto level ground, as measured."""
    rng = np.random.default_rng(11)
    truths = bounce(cube, rng, tosses=40, frames=110)
    return [tracked(truth, rng, name=str(i)) for i, truth in enumerate(truths)]


@pytest.fixture(scope="session")
def odd(cube: ObjectModel) -> ObjectModel:
    """A body whose recorded frame is off its centre of mass, with three different moments of inertia."""
    return cube.with_changes(com=np.array([[0.01, -0.005, 0.008]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])


class Tossed(NamedTuple):
    """Noisy tosses of an object, and the object as it is."""

    tosses: tuple[Toss, ...]
    true: ObjectModel


@pytest.fixture(scope="package")
def wedge() -> Tossed:
    made = toss_shape("wedge", ShapeTossSettings(tosses=20))
    return Tossed(tosses_from_tracks(made.tracks, unstated_object()), made.object)


@pytest.fixture(scope="package")
def linked() -> Tossed:
    """Noisy tosses of an elbow of two solid links, each in a tracker's frame; the hinge is the one found."""
    made = toss_links(ShapeTossSettings(tosses=20, mass=0.37))
    found = find_hinge(made.first, made.second)
    hinged = unstated_object(hinge=found.hinge)
    tosses = tosses_from_tracks(hinged_tracks(made.first, made.second, found), hinged)
    return Tossed(tosses, made.in_tracked_frames(hinged))
