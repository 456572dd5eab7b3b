"""Parameters that are started again where their start led nowhere, and whether training has converged.

The implicit loss moves a corner that touches the ground. One that never touches has no gradient: it stays inside the
body, or on a corner that another one already explains. Frames show this (`tossid.objects.shape_evidence`), and their
hull says where a corner is missing. What is started again is kept only if it ends with a lower validation loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.models.trained import EpochRecord
from tossid.objects import ObjectModel, body_poses, corner_heights, corner_positions
from tossid.objects.convex_shape import ConvexShape
from tossid.objects.half_spaces import protrusion, turned
from tossid.objects.model import HULL_POINTS
from tossid.objects.roundness import directions
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.rotations import quat_to_matrix
from tossid.settings.objects import EvidenceSettings
from tossid.settings.training import RestartSettings, TrainSettings
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


UNDETERMINED = "inertia and contact law"
"""What is not kept where validation tosses are not predicted clearly better than with friction alone."""


@dataclass(frozen=True)
class Restart:
    """A parameter that was started again.

    Attributes:
        stage: In which stage of training.
        what: "corners", "all corners" (which are then followed to an end that does not depend on the start),
            "friction", or `UNDETERMINED`, which was learned and is not kept.
        moved: How many numbers were moved: corners, or all that a stage learns.
        kept: Whether the validation loss then ended lower than before (for all corners: not much higher); if not, what
            was before was restored.
    """

    stage: str
    what: str
    moved: int
    kept: bool


@dataclass
class Following:
    """Passes of a stage with gaps of decreasing width, each to the end of its training loss.

    Attributes:
        widths: Of the present pass and those to come, relative to the model's own.
        loss: Validation loss before them.
        before: The model before them.
        ends_at: Validation loss of the last epoch.
    """

    widths: list[float]
    loss: float
    before: dict[str, Any]
    ends_at: float = float("inf")

    PATIENCE = 2
    """Epochs without a lower training loss after which a pass has ended."""


def evidence_of(tosses: Sequence[Toss], settings: RestartSettings, **known: Any) -> ShapeEvidence | str:
    """The frames against which corners are held, or why there are none.

    Args:
        tosses: For training, with true lengths.
        settings: What contradicts corners.
        **known: Further arguments of `ShapeEvidence`.
    """
    if tosses[0].q.shape[1] != 7:
        return "objects with joints are not held against the hull of their frames"
    try:
        return ShapeEvidence(tosses, settings.evidence, **known)
    except InputError as error:
        return str(error)


def judging_frames(
    train: Sequence[Toss], validation: Sequence[Toss], settings: TrainSettings, known: ConvexShape | None
) -> tuple[ShapeEvidence | str, ShapeEvidence | str]:
    """The frames that judge corners, and those that say where corners that are started again begin.

    Frames of validation tosses judge: a corner that never touched in a few training tosses, others bring down. They
    move no corner where training tosses are rationed: who asks what eight tosses teach means these eight.

    Args:
        train: Tosses with true lengths.
        validation: The same.
        settings: Whether tosses are rationed.
        known: The hull of the frames, where it is known already.
    """
    limits, rationed = settings.restarts, settings.tosses is not None
    judges = evidence_of((*train, *validation), limits, shape=None if rationed else known)
    return judges, evidence_of(train, limits, shape=known) if rationed else judges


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


def seen_corners(model: ObjectModel, tosses: Sequence[Toss], settings: EvidenceSettings) -> NDArray[np.bool_]:
    """Marks corners (n,) that contacts of tosses have shown.

    Frames in flight are no contacts, however low a corner is: one that is learned too far out sinks into the ground
    before the object lands. A body that lies still is one contact.

    Args:
        model: The object as it was learned.
        tosses: With true lengths.
        settings: How near the ground, and in how many different contacts.
    """
    reach = settings.seen_rel * 0.5 * model.width
    if model.roundness is not None:
        return _seen_directions(model, tosses, reach, settings)
    count = np.zeros(model.n_corners, dtype=np.int64)
    for toss in tosses:
        q = toss.q[toss.phase != Phase.FLIGHT]
        touching = corner_heights(model, q) < reach
        down = -quat_to_matrix(body_poses(model, q)[1])[..., 2, :]
        for corner in np.flatnonzero((count < settings.fewest_seen) & touching.any(axis=0)):
            ways = down[touching[:, corner], model.corner_body[corner]]
            count[corner] += turned(ways, settings.seen_turn).sum()
    return np.asarray(count >= settings.fewest_seen)


def _seen_directions(
    model: ObjectModel, tosses: Sequence[Toss], reach: float, settings: EvidenceSettings
) -> NDArray[np.bool_]:
    """Marks points of a round object's surface (`ObjectModel.as_points`) whose normal pointed down in contacts."""
    ways, found = directions(HULL_POINTS), []
    for body in sorted(set(model.corner_body.tolist())):
        own, down = model.corner_body == body, [np.zeros((0, 3))]
        for toss in tosses:
            q = toss.q[toss.phase != Phase.FLIGHT]
            touching = corner_positions(model, q)[:, own, 2].min(axis=1) < reach
            quat = body_poses(model, q[touching])[1][:, body]
            down.append(-quat_to_matrix(quat)[:, 2, :])
        near = ways @ np.concatenate(down).T > np.cos(settings.seen_angle)
        found.append(near.sum(axis=1) >= settings.fewest_seen)
    return np.concatenate(found)


def geometry_report(
    model: ObjectModel, seen: NDArray[np.bool_], *, length_scale: float, way: Sequence[Any] = ()
) -> list[dict[str, Any]]:
    """The learned corners of each body, which of them tosses have shown, and from where they came.

    Args:
        model: The object as it was learned.
        seen: (n,), of `seen_corners`; of a round object, of the points of its surface.
        length_scale: Recorded length per true length.
        way: Corners (n_c, 3) before training and after each stage that moved them, true lengths; empty of round
            objects, whose corners stay.

    Returns:
        An entry a body: `vertices_m` in the recorded body frame, `seen`, and `way_m`, the vertices before training and
        after each stage that moved them; empty where none did.
    """
    if model.roundness is not None:
        model, way = model.as_points(), ()
    own = [model.corner_body == body for body in range(model.n_bodies)]
    corners = length_scale * model.corner_pos
    steps = [length_scale * np.array(step) for step in way] if len(way) > 1 else []
    return [
        {
            "vertices_m": corners[which].round(6).tolist(),
            "seen": seen[which].tolist(),
            "way_m": [step[which].round(6).tolist() for step in steps],
        }
        for which in own
    ]


def convergence(
    model: ObjectModel,
    evidence: ShapeEvidence | str,
    history: Sequence[EpochRecord],
    restarts: Sequence[Restart],
    settings: TrainSettings,
) -> dict[str, Any]:
    """Whether training has converged, as far as training and validation tosses can tell.

    Args:
        model: The object as it was learned.
        evidence: The frames of training and validation tosses, or why there are none.
        history: The epochs.
        restarts: What was started again.
        settings: How it was trained.

    Returns:
        {"converged", "reasons": [text], "restarts": [...], "geometry_checked": true or why not}.
    """
    limits = settings.restarts
    reasons = [*_unfinished(history, settings), *_body(model)]
    low, high = limits.friction_range
    if not low < model.friction < high:
        reasons.append(f"friction ran to {model.friction:.3g}, where rollouts hardly depend on it")
    checked: bool | str = True
    if isinstance(evidence, str):
        checked = evidence
    else:
        contradiction = evidence.contradiction(model.corner_pos)
        reasons += [] if contradiction is None else [contradiction]
    return {
        "converged": not reasons,
        "reasons": reasons,
        "restarts": [asdict(restart) for restart in restarts],
        "geometry_checked": checked,
    }


def _unfinished(history: Sequence[EpochRecord], settings: TrainSettings) -> list[str]:
    """Stages that ended at their most epochs while the validation loss still fell."""
    found = []
    for stage, group in groupby(history, key=lambda record: record.stage):
        records = list(group)
        most = settings.rollouts.epochs if stage.startswith("rollout") else settings.epochs
        losses = [record.validation_loss for record in records]
        earlier = min(losses[: -settings.patience], default=losses[0])
        if records[-1].epoch >= most and min(losses) < earlier * (1 - settings.restarts.still_falling):
            found.append(f"stage {stage} ended after {most} epochs while its loss still fell")
    return found


def _body(model: ObjectModel) -> list[str]:
    """Centres of mass and moments of inertia that no mass within the corners has."""
    found = []
    for body in range(model.n_bodies):
        drawn = model.drawn
        corners, name = drawn.corner_pos[drawn.corner_body == body], model.body_names[body]
        if len(corners) < 4:
            continue
        if protrusion(model.com[body], corners) > OUTSIDE * model.width:
            found.append(f"the centre of mass of {name} lies outside its corners")
        reach = np.linalg.norm(corners - model.com[body], axis=1).max()
        if np.trace(model.inertia[body]) > 2 * model.mass[body] * reach**2 * LARGER:
            found.append(f"{name} has more inertia than its mass at its farthest corner would have")
    return found


OUTSIDE, LARGER = 0.02, 1.05
"""By how much a centre of mass may be outside (widths), and an inertia beyond what is possible (ratio)."""
