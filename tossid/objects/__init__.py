"""Objects: from MJCF or URDF to a kinematic tree with corners and tags, and back."""

from tossid.objects.boxes import box
from tossid.objects.kinematics import body_poses, center_positions, corner_heights, corner_positions, lowest_points
from tossid.objects.load import OBJECT_FILES, absolute_paths, load_object
from tossid.objects.mjcf import object_from_mjcf, to_mjcf
from tossid.objects.model import GRAVITY, JointLaw, JointType, ObjectModel, Tag, free_joints
from tossid.objects.recorded import recorded_object, write_object
from tossid.objects.roundness import Roundness
from tossid.objects.tags import read_tags
from tossid.objects.unstated import need_stated, unstated_object
from tossid.objects.urdf import to_urdf

__all__ = [
    "GRAVITY",
    "JointLaw",
    "JointType",
    "OBJECT_FILES",
    "ObjectModel",
    "Roundness",
    "Tag",
    "absolute_paths",
    "body_poses",
    "box",
    "center_positions",
    "corner_heights",
    "corner_positions",
    "free_joints",
    "load_object",
    "lowest_points",
    "need_stated",
    "object_from_mjcf",
    "read_tags",
    "recorded_object",
    "to_mjcf",
    "to_urdf",
    "unstated_object",
    "write_object",
]
