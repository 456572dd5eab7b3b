"""Corners that are started again where their start led nowhere.

The implicit loss moves a corner that touches the ground. One that never touches has no gradient: it stays inside the
body, or on a corner that another one already explains. Frames show this (`tossid.objects.shape_evidence`), and their
hull says where a corner is missing. Where they contradict stated corners, training starts from those of the hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.objects.convex_shape import ConvexShape
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.types import Toss

UNDETERMINED = "inertia and contact law"
"""What is not kept where validation tosses are not predicted clearly better than with friction alone."""


@dataclass(frozen=True)
class Restart:
    """A parameter that was started again.

    Attributes:
        stage: For which stage of training.
        what: "corners", "friction", or `UNDETERMINED`, which was learned and is not kept.
        moved: How many numbers were moved: corners, or all that a stage learns.
        kept: Whether it was kept; if not, what was before was restored.
    """

    stage: str
    what: str
    moved: int
    kept: bool


def evidence_of(tosses: Sequence[Toss], *, shape: ConvexShape | None = None) -> ShapeEvidence | str:
    """The frames against which corners are held, or why there are none.

    Args:
        tosses: For training, with true lengths.
        shape: The hull of their frames, where it is known already.
    """
    if tosses[0].q.shape[1] != 7:
        return "objects with joints are not held against the hull of their frames"
    try:
        return ShapeEvidence(tosses, shape=shape)
    except InputError as error:
        return str(error)


def judging_frames(
    train: Sequence[Toss], validation: Sequence[Toss], known: ConvexShape | None, *, rationed: bool
) -> tuple[ShapeEvidence | str, ShapeEvidence | str]:
    """The frames that judge corners, and those that say where corners that are started again begin.

    Frames of validation tosses judge: a corner that never touched in a few training tosses, others bring down. They
    move no corner where training tosses are rationed: who asks what eight tosses teach means these eight.

    Args:
        train: Tosses with true lengths.
        validation: The same.
        known: The hull of the frames, where it is known already.
        rationed: Whether fewer tosses are learned from than there are.
    """
    judges = evidence_of((*train, *validation), shape=None if rationed else known)
    return judges, evidence_of(train, shape=known) if rationed else judges


def with_shown_corners(start: ObjectModel, evidence: ShapeEvidence) -> ObjectModel:
    """An object with the corners that tosses show, evenly filled; as it is where they show fewer than four.

    Args:
        start: A rigid body.
        evidence: The frames.
    """
    shown = evidence.shown()
    if len(shown) < 4:
        return start
    inertia = start.mass[:, None, None] * evidence.shape.solid()[2]
    return start.with_changes(corner_pos=shown, corner_body=np.zeros(len(shown), dtype=np.int64), inertia=inertia)
