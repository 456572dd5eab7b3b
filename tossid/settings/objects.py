"""What an object's file cannot say, and the objects that come with tossid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tossid.settings.kinds import Checked
from tossid.settings.limits import Friction, Length, Restitution


@dataclass(frozen=True)
class ObjectSettings(Checked):
    """The object that is tossed."""

    name: str
    """what it is called"""
    path: Path
    """its MJCF or URDF file; a relative path is sought in the working folder, then beside tossid's own package"""
    friction: Friction = 0.18
    """Coulomb friction of object and ground"""
    restitution: Restitution = 0.0
    """Newton's restitution, 0 for none"""
    width: Length | None = None
    """length that position errors refer to [m]; null: the longest edge of the base"""
    tags: Path | None = None
    """its AprilTags, in TagSLAM's tagslam.yaml form; null: none"""


_LIBRARY = Path("tossid/objects/library")

PRESETS = {
    "cube": ObjectSettings("cube", _LIBRARY / "cube.xml", width=0.1048, tags=_LIBRARY / "cube_tags.yaml"),
    "elbow": ObjectSettings("elbow", _LIBRARY / "elbow.xml", width=0.1, tags=_LIBRARY / "elbow_tags.yaml"),
}
"""The objects that are known by name. The cube is that of the published ContactNets tosses, the elbow that of dair_pll:
two links on a hinge."""
