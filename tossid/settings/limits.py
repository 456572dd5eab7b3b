"""Limits of what comes from outside: what a file may claim, and the values that a toss and an object may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tossid.settings.kinds import Bounds, Count, Positive

LARGEST_GRAVITY = 1e3
"""[m/s²], a hundred times the earth's."""
LARGEST_FRICTION = 1e2
"""Coulomb's coefficient."""
LARGEST_LENGTH = 1e3
"""Of an object [m]."""
LARGEST_MASS = 1e6
"""Of a body [kg]."""

Gravity = Annotated[float, Bounds(low=0, high=LARGEST_GRAVITY)]
Friction = Annotated[float, Bounds(low=0, high=LARGEST_FRICTION)]
Restitution = Annotated[float, Bounds(low=0, high=1)]
Length = Annotated[float, Bounds(above=0, high=LARGEST_LENGTH)]
Mass = Annotated[float, Bounds(above=0, high=LARGEST_MASS)]


@dataclass(frozen=True, kw_only=True)
class ReadLimits:
    """What a file may claim before it is refused (`tossid.budget`)."""

    unpacked: Count = 1 << 26
    """bytes that any packed file may unpack to (64 MiB)"""
    ratio: Count = 100
    """bytes that a packed file may unpack to, for each byte of it, where that is more"""
    pickled: Count = 1 << 22
    """bytes of a `.pt` file that are no tensors (4 MiB): each may make sixty when it is read"""
    chunk: Count = 1 << 25
    """bytes that one chunk of a bag may unpack to (32 MiB), or `ratio` times its size, where that is more"""
    pixels: Count = 50_000_000
    """pixels of an image or texture"""
    scanned: Count = 500_000_000
    """pixels in all scans of a JPEG together: a progressive one repeats its pixels, mostly ten times"""
    cameras: Count = 1_000
    """cameras of a file of detections"""
    model_text: Count = 1 << 21
    """bytes of an MJCF or URDF text"""
    model_file: Count = 1 << 26
    """bytes of a mesh or other file that a model names"""
    elements: Count = 5_000
    """elements of an MJCF or URDF, with all copies that it asks for"""
    corners: Count = 2_000
    """contact corners of an object"""
    tags: Count = 5_000
    """tags of a layout"""
    yaml_values: Count = 40_000
    """values and names that are written in a YAML file: a thousand take PyYAML some 25 ms"""
    yaml_nodes: Count = 200_000
    """values of a YAML file, with all that its aliases repeat"""
    message_items: Count = 10_000
    """items of the arrays of fixed length in a ROS message that are not plain numbers, all together"""


@dataclass(frozen=True, kw_only=True)
class ValueLimits:
    """Values of motions and objects beyond which nothing is computed: no measurement, and no toss, is meant by them.

    They hold wherever a motion or an object is made, read or given. Those of importers are narrower, and say that units
    are wrong.
    """

    time: Positive = 1e12
    """largest time stamp, either way [s]"""
    duration: Positive = 1e7
    """longest motion [s]"""
    position: Positive = 1e4
    """largest distance from the origin along an axis [m]; also a joint's largest angle [rad]"""
    velocity: Positive = 1e6
    """largest velocity along or about an axis [m/s, rad/s]"""
    covariance: Positive = 1e20
    """largest entry of a covariance [m², rad², …]"""
    gravity: Positive = LARGEST_GRAVITY
    """largest gravity [m/s²]"""
    friction: Positive = LARGEST_FRICTION
    """largest coefficient of friction"""
    length: Positive = LARGEST_LENGTH
    """largest width, corner, centre of mass or place of a joint of an object [m]"""
    mass: Positive = LARGEST_MASS
    """largest mass of a body [kg]"""
    contact: Positive = 1e6
    """largest compliance [m/N], relaxation [s] and cohesion [N]"""


VALUES = ValueLimits()
"""The limits in force."""
