"""The dataset's schema `tossid.dataset/1`.

    /                 attributes: schema, source, rate_hz, frames, covariance_source, n_tosses, n_frames;
                      sessions (JSON, where the order of recording was looked at)
    /object           attributes: name, friction, restitution, width_m, nq, nv;
                      compliance, relaxation, cohesion (only where they are not 0)
    /object/mjcf      the object as MJCF text (UTF-8)
    /object/tags      a row a tag: id, body, size_m, T_body_tag (only where there are tags)
    /object/hinge     of two links of which nothing else is stated
    /provenance       attributes: a flat dictionary, what the dataset was made from
    /tosses/NAME      attributes: index (its place), split ("" where none was drawn);
                      session, recorded_as (place in the order of recording), witnesses (what it says of it),
                      place_m (where it ends), turn and shift_m (T in levelled = T recorded: wxyz, and then up)
        t (n)  q (n, nq)  v (n, nv)  q_cov (n, nv, nv)  v_cov (n, nv, nv)  phase (n)
        q_measured (n, nq)  q_measured_cov (n, nv, nv)  (only where q was smoothed)

Each array carries its unit and frame as attributes. Why this schema: docs/adr/0003-dataset-schema.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SCHEMA = "tossid.dataset/1"
KNOWN_SCHEMAS = (SCHEMA,)

FRAMES = (
    "world: z up, ground z = 0; q = position of the base frame (world), quaternion wxyz (world from base), joints; "
    "v = linear velocity of the base frame's origin (world), angular velocity (body), joint rates; "
    "covariances in the tangent space of v's order, rotations perturbed on the right (body)"
)
MAX_ATTRIBUTE_TEXT = 32_000
CONTACT_LAW = ("compliance", "relaxation", "cohesion")
"""Attributes of an object that are absent where they are 0, as in files that are older than they."""
HINGE_MEANING = "link 2 in link 1 at angle zero: position, quaternion wxyz; in link 2: a point of the axis, the axis"
"""Of the array `/object/hinge` (13,)."""
TAG_DTYPE = np.dtype([("id", "<i8"), ("body", "<i8"), ("size_m", "<f8"), ("T_body_tag", "<f8", (4, 4))])


@dataclass(frozen=True, slots=True)
class Member:
    """One array of a toss.

    Attributes:
        name: Of the array, here and in `tossid.types.Toss`.
        shape: Names of its dimensions: "n", "nq" or "nv".
        dtype: Its type.
        unit: Its unit.
        meaning: What it is, and in which frame.
        optional: Whether it may be absent.
    """

    name: str
    shape: tuple[str, ...]
    dtype: str
    unit: str
    meaning: str
    optional: bool = False


MEMBERS = (
    Member("t", ("n",), "<f8", "s", "time"),
    Member("q", ("n", "nq"), "<f8", "m, 1, rad", "position, quaternion wxyz, joints"),
    Member("v", ("n", "nv"), "<f8", "m/s, rad/s, rad/s", "linear (world), angular (body), joint rates"),
    Member("q_cov", ("n", "nv", "nv"), "<f8", "(m, rad, rad)^2", "covariance of q: world, body, joints"),
    Member("v_cov", ("n", "nv", "nv"), "<f8", "(m/s, rad/s, rad/s)^2", "covariance of v: world, body, joints"),
    Member("phase", ("n",), "|u1", "1", "0 unknown, 1 flight, 2 impact, 3 slide, 4 roll, 5 rest"),
    Member("q_measured", ("n", "nq"), "<f8", "m, 1, rad", "the single poses that q was smoothed from", True),
    Member("q_measured_cov", ("n", "nv", "nv"), "<f8", "(m, rad, rad)^2", "covariance of q_measured", True),
)
