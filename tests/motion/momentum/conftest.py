from dataclasses import dataclass

import pytest

from tossid.motion import tosses_from_tracks
from tossid.motion.hinge import find_hinge, hinged_tracks
from tossid.objects import ObjectModel, unstated_object
from tossid.settings.synthesis import ShapeTossSettings
from tossid.synthesis.linked import toss_links
from tossid.synthesis.shapes import toss_shape
from tossid.types import Toss


@dataclass(frozen=True)
class Tossed:
    """Noisy tosses of an object, and the object as it is."""

    tosses: tuple[Toss, ...]
    true: ObjectModel


@pytest.fixture(scope="package")
def wedge() -> Tossed:
    """MuJoCo's friction is not Coulomb's in impacts, which the balance of momentum does not mind."""
    made = toss_shape("wedge", ShapeTossSettings(tosses=20))
    tosses = tosses_from_tracks(made.tracks, unstated_object())
    return Tossed(tosses, made.object)


@pytest.fixture(scope="package")
def elbow() -> Tossed:
    """Noisy tosses of an elbow of two solid links, each in a tracker's frame; the hinge is the one found."""
    made = toss_links(ShapeTossSettings(tosses=20, mass=0.37))
    found = find_hinge(made.first, made.second)
    hinged = unstated_object(hinge=found.hinge)
    tosses = tosses_from_tracks(hinged_tracks(made.first, made.second, found), hinged)
    return Tossed(tosses, made.in_tracked_frames(hinged))
