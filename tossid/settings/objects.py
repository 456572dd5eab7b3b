"""What an object's file cannot say, and the objects that come with tossid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tossid.settings.kinds import (
    Bounds,
    Checked,
    Count,
    Except,
    Fraction,
    NonNegative,
    Positive,
    advanced,
    advanced_part,
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
class ShapeSettings(Checked):
    """How a convex shape is found from poses alone (`tossid.objects.convex_shape`)."""

    noise: Positive = 3e-4
    """standard deviation of the recorded heights of a corner [m]"""
    gap: Positive = 1e-3
    """scale of the loss above the ground: higher frames count less and less as contacts [m]"""
    first_gap: Positive = 4e-3
    """the same at the first iteration, when vertices are far from where they belong [m]"""
    gap_noises: Positive = 2.0
    """the same for the last fit of a polytope, in standard deviations of the gaps' noise, where that is less"""
    contact_gap: Positive = 1.5e-3
    """largest distance of the lowest vertex from the ground in a frame that is counted as a contact [m]"""
    near_rel: Positive = 0.5
    """frames take part whose gap to the outer hull is below this share of the radius of the largest ball inside"""
    merge_rel: Positive = 0.15
    """vertices of the outer hull closer than this share of that radius are one vertex to begin with"""
    feature_rel: Positive = 0.02
    """share of the largest extent by which a vertex must stand out from the hull of the others"""
    most_frames: Count = 4000
    """frames, evenly drawn, from which the number of vertices is found; the last fit takes all"""
    round_frames: Count = 1500
    """frames, evenly drawn, from which round shapes are found"""
    unseen_rel: Positive = 0.15
    """share of that radius by which the outer hull may lie beyond the shape before it is reported as unseen"""
    seen_angle: Positive = 0.15
    """angle from the downward direction of a contact within which points of a round surface count as seen [rad]"""
    level_height: Positive = 4e-3
    """height of the ground found with the hull from which on the world is levelled [m]; less is also what rounded edges
    look like"""
    level_slope: Positive = 5e-3
    """the same for its slope"""
    other_angle: Positive = 8.7e-3
    """turn from the last frame that counted after which a frame of a toss counts again [rad]"""
    other_height: Positive = 2e-4
    """change of height after which it does [m]"""
    careful_below: Count = 16
    """number of vertices up to which they are left out one by one, the best of three ways each time"""
    dropped_share: Fraction = 0.1
    """share of the vertices that is left out at once while there are more"""
    iterations: Count = 40
    """most steps of a fit"""
    converged: Positive = 2e-6
    """change of a vertex below which a fit ends [m]"""
    inertia: Positive = 0.3
    """weight of where a vertex was, in frames: it holds vertices that few frames show"""
    fewest_contacts: Count = 30
    """different contacts below which there is no shape"""
    largest: Positive = 5.0
    """farthest that an object may reach from the origin of its frame [m]"""
    smallest: Positive = 1e-3
    """smallest radius of the largest ball inside an object [m]"""


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings(Checked):
    """What frames say against corners (`tossid.objects.shape_evidence`)."""

    tight_rel: Positive = 0.05
    """a frame is tight when its gap to the outer hull is below this share of the radius of the largest ball inside"""
    missing_rel: Positive = 0.1
    """share of that radius by which all corners may stay above the ground in a tight frame, and by which a corner may
    be off one that the tosses show"""
    outside_rel: Positive = 0.25
    """share of that radius by which a corner may be below the ground in some frame; real ones sink at impacts"""
    unexplained_share: Positive = 2e-3
    """share of the tight frames that corners may leave unexplained"""
    fewest_shown: Count = 5
    """different contacts that show a corner"""
    seen_rel: Positive = 0.06
    """height below which a learned corner touches the ground, as a share of that radius, or of half the width where no
    radius is known"""
    seen_angle: Positive = 0.2
    """angle from the downward direction in a contact within which points of a round surface count as seen [rad]"""
    seen_turn: Positive = 0.087
    """turn of the body since the last contact that counted, after which a touching corner counts again [rad]"""
    fewest_seen: Count = 3
    """contacts of a learned corner from which on it counts as seen; of a round surface, frames"""


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
    shape: ShapeSettings = advanced_part(ShapeSettings)
    """how its shape is found"""


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
