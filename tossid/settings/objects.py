"""What an object's file cannot say, and the objects that come with tossid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tossid.settings.kinds import (
    Bounds,
    Checked,
    Except,
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
    """Coulomb friction that training starts from where too few tosses slide to show it"""


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
