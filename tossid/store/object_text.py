"""An object as the text and the few values that a dataset carries, and back."""

from __future__ import annotations

from typing import Any

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
        ObjectError: Neither describes the object's arrays.
    """
    if _gives(model.mjcf, model):
        return model.mjcf
    text = to_mjcf(model, ground=False)
    if _gives(text, model):
        return text
    raise ObjectError(f"object '{model.name}' cannot be kept in a dataset: its MJCF does not give its bodies back")


def model_of_text(text: str, *, tags: NDArray[np.void] | None, **stated: Any) -> ObjectModel:
    """The object that `text_of_model` wrote.

    Args:
        text: MJCF that names no other files.
        tags: Rows of `tossid.store.schema.TAG_DTYPE`, or None.
        **stated: What the text cannot say, see `tossid.objects.mjcf.Stated`.

    Raises:
        ObjectError: MuJoCo cannot read the text, the text names other files, or a value cannot be.
    """
    check_alone(text)
    rows = () if tags is None else tags
    found = tuple(Tag(int(r["id"]), float(r["size_m"]), int(r["body"]), np.array(r["T_body_tag"])) for r in rows)
    model = object_from_mjcf(text, tags=found, **stated)
    for tag in found:
        if not 0 <= tag.body < model.n_bodies or not np.isfinite(tag.T_body_tag).all() or not tag.size > 0:
            raise ObjectError(f"tag {tag.id} has no such body, pose or size")
    return model


def _gives(text: str, model: ObjectModel) -> bool:
    """Whether a text alone gives an object back: its bodies, joints, inertia and corners (in any order)."""
    if not text or not stands_alone(text):
        return False
    try:
        again = object_from_mjcf(text, friction=model.friction, width=model.width)
    except ObjectError:
        return False
    if not (np.array_equal(model.parent, again.parent) and np.array_equal(model.joint_type, again.joint_type)):
        return False
    # (the base's own place and the axis of its joint, which is none, say nothing)
    first = {"mass": 0, "inertia": 0, "body_pos": 1, "body_quat": 1, "joint_pos": 1, "joint_axis": 1}
    for name, at in first.items():
        mine, theirs = getattr(model, name)[at:], getattr(again, name)[at:]
        if not np.allclose(mine, theirs, rtol=_TOLERANCE, atol=_TOLERANCE * np.abs(mine).max(initial=1e-12)):
            return False
    if not np.allclose(model.com, again.com, rtol=_TOLERANCE, atol=_TOLERANCE * model.width):
        return False
    return all(_same_points(model, again, body) for body in range(model.n_bodies))


def _same_points(model: ObjectModel, again: ObjectModel, body: int) -> bool:
    mine, theirs = (each.corner_pos[each.corner_body == body] for each in (model, again))
    if not len(mine) or len(mine) != len(theirs):
        return len(mine) == len(theirs)
    gaps = np.linalg.norm(mine[:, None] - theirs[None], axis=-1)
    return bool(max(gaps.min(axis=1).max(), gaps.min(axis=0).max()) < _TOLERANCE * model.width)
