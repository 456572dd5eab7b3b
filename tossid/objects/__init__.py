"""Objects: from MJCF or URDF to a kinematic tree with corners and tags, and back."""

from tossid.objects.kinematics import body_poses, center_positions, corner_positions
from tossid.objects.mjcf import load_object, object_from_mjcf, to_mjcf
from tossid.objects.model import GRAVITY, JointLaw, JointType, ObjectModel, Tag, free_joints
from tossid.objects.urdf import to_urdf

__all__ = [
    "GRAVITY",
    "JointLaw",
    "JointType",
    "ObjectModel",
    "Tag",
    "body_poses",
    "center_positions",
    "corner_positions",
    "free_joints",
    "load_object",
    "object_from_mjcf",
    "to_mjcf",
    "to_urdf",
]
