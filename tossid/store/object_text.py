"""An object as the text and the few values that a dataset carries, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.objects import ObjectModel, Tag, object_from_mjcf, to_mjcf
from tossid.objects.references import check_alone, stands_alone

_TOLERANCE = 1e-6
"""MuJoCo writes six digits and keeps mesh vertices in single precision: relative to the object's own sizes."""


def text_of_model(model: ObjectModel) -> str:
    """MJCF text that gives the object back: its own where that is current and self-contained, else `to_mjcf`'s.

    Raises:
        ObjectError: neither describes the object's arrays.
    """
    for text in (model.mjcf, None):
        if text is None:
            text = to_mjcf(model, ground=False)
        if not text or not stands_alone(text):
            continue
        try:
            again = object_from_mjcf(text, friction=model.friction, width=model.width)
        except ObjectError:
            continue
        if _same(model, again):
            return text
    raise ObjectError(f"object '{model.name}' cannot be kept in a dataset: its MJCF does not give its bodies back")


def model_of_text(
    text: str,
    *,
    name: str,
    friction: float,
    restitution: float,
    compliance: float,
    relaxation: float,
    cohesion: float,
    width: float,
    tags: NDArray[np.void] | None,
) -> ObjectModel:
    """The object that `text_of_model` wrote.

    Args:
        text: MJCF that names no other files.
        name: The object's name.
        friction: Coulomb's coefficient of object and ground.
        restitution: Newton's coefficient.
        compliance: How far a corner sinks for each newton on it [m/N].
        relaxation: Damping over stiffness of a corner [s].
        cohesion: Friction of a loaded corner beyond `friction` times its load [N].
        width: Reference length [m].
        tags: Rows of `tossid.store.schema.TAG_DTYPE`, or None.

    Raises:
        ObjectError: MuJoCo cannot read the text, the text names other files, or a value cannot be.
    """
    check_alone(text)
    if friction < 0 or restitution < 0 or width <= 0:
        raise ObjectError(f"friction {friction}, restitution {restitution} or width {width} m cannot be")
    found: tuple[Tag, ...] = ()
    if tags is not None:
        found = tuple(
            Tag(id=int(row["id"]), size=float(row["size_m"]), body=int(row["body"]), T_body_tag=row["T_body_tag"] + 0)
            for row in tags
        )
    model = object_from_mjcf(
        text,
        name=name,
        friction=friction,
        restitution=restitution,
        compliance=compliance,
        relaxation=relaxation,
        cohesion=cohesion,
        width=width,
        tags=found,
    )
    for tag in found:
        if not 0 <= tag.body < model.n_bodies or not np.isfinite(tag.T_body_tag).all() or not tag.size > 0:
            raise ObjectError(f"tag {tag.id} has no such body, pose or size")
    return model


def _same(a: ObjectModel, b: ObjectModel) -> bool:
    """Whether two objects have the same bodies, joints, inertia and corners (in any order)."""
    if a.n_bodies != b.n_bodies or a.n_corners != b.n_corners:
        return False
    if not (np.array_equal(a.parent, b.parent) and np.array_equal(a.joint_type, b.joint_type)):
        return False
    pairs = [(a.mass, b.mass), (a.inertia, b.inertia)]
    # the base's own place and the axes of joints that are none say nothing
    pairs += [(x[1:], y[1:]) for x, y in ((a.body_pos, b.body_pos), (a.body_quat, b.body_quat))]
    pairs += [(x[1:], y[1:]) for x, y in ((a.joint_pos, b.joint_pos), (a.joint_axis, b.joint_axis))]
    scale = a.width
    close = all(np.allclose(x, y, rtol=_TOLERANCE, atol=_TOLERANCE * np.abs(x).max(initial=1e-12)) for x, y in pairs)
    close = close and np.allclose(a.com, b.com, rtol=_TOLERANCE, atol=_TOLERANCE * scale)
    for body in range(a.n_bodies):
        here, there = a.corner_pos[a.corner_body == body], b.corner_pos[b.corner_body == body]
        if len(here) != len(there):
            return False
        if len(here):
            gaps = np.linalg.norm(here[:, None] - there[None], axis=-1)
            close = (
                close and gaps.min(axis=1).max() < _TOLERANCE * scale and gaps.min(axis=0).max() < _TOLERANCE * scale
            )
    return bool(close)
