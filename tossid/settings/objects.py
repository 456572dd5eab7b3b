"""What an object's file cannot say, and the objects that come with tossid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tossid.settings.kinds import (
    Bounds,
    Checked,
    Except,
    Fraction,
    NonNegative,
    Positive,
    advanced,
)
from tossid.settings.limits import Friction, Length, Mass, Restitution


@dataclass(frozen=True)
class ObjectSettings(Checked):
    """The object that is tossed."""

    name: Annotated[str, Except("unknown")]
    """what it is called"""
    path: Path
    """its MJCF or URDF file; a relative path is sought in the working folder, then beside tossid's own package"""
    friction: Friction | None = None
    """Coulomb friction of object and ground; null: as its file states it, else a guess (0.18)"""
    restitution: Restitution = 0.0
    """Newton's restitution, 0 for none"""
    width: Length | None = None
    """length that position errors refer to [m]; null: the longest edge of the base"""
    tags: Path | None = None
    """its AprilTags, in TagSLAM's tagslam.yaml form; null: none"""


@dataclass(frozen=True, kw_only=True)
class UnknownObjectSettings(Checked):
    """A rigid body, or two links on a hinge, of which nothing is stated but the mass."""

    name: Literal["unknown"] = "unknown"
    """nothing is stated but the mass"""
    mass: Mass = 1.0
    """its whole mass [kg]; tosses show ratios of masses only"""
    links: Annotated[int, Bounds(low=1, high=2)] = 1
    """rigid bodies of which it consists: 1, or 2 on a hinge, whose poses are tracked each"""
    friction: Friction = 0.3
    """Coulomb friction that training starts from"""
    sure: NonNegative = advanced(3e-4)
    """standard error up to which corners, and the centre of mass, stay as the tosses showed them [m]: training would
    move them to explain what its model lacks. 0 refines them in any case"""
    sure_inertia: NonNegative = advanced(0.05)
    """relative standard error up to which the inertia that the balance of momentum gives is taken and stays; above, it
    is that of an evenly filled shape, and is learned"""
    sure_friction: NonNegative = advanced(0.04)
    """standard error up to which the friction of steady sliding is taken and stays: rollouts, whose law of contact is
    not the object's, miss it by as much"""
    rest_off_rel: Positive = advanced(0.02)
    """share of the mean width by which the shape may be above or below the ground when a toss has come to rest"""
    most_rest_off: Fraction = advanced(0.1)
    """share of the tosses at rest that may be farther off; from two on, more are refused: the body's frame jumps"""


_LIBRARY = Path("tossid/objects/library")

PRESETS = {
    "cube": ObjectSettings(
        "cube", _LIBRARY / "cube.xml", friction=0.18, width=0.1048, tags=_LIBRARY / "cube_tags.yaml"
    ),
    "elbow": ObjectSettings(
        "elbow", _LIBRARY / "elbow.xml", friction=0.3, width=0.1, tags=_LIBRARY / "elbow_tags.yaml"
    ),
}
"""The objects that are known by name. The cube is that of the published ContactNets tosses, the elbow that of dair_pll:
two links on a hinge."""
