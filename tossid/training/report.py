"""What is said of a training when it has ended: which corners tosses have shown, and whether it has converged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.models.trained import EpochRecord
from tossid.motion import MeasurementEstimate, MeasurementModel
from tossid.motion.measurement import FEWEST_TOSSES, SIZE_WARNING
from tossid.objects import ObjectModel, body_poses, corner_heights, corner_positions
from tossid.objects.half_spaces import protrusion, turned
from tossid.objects.model import HULL_POINTS
from tossid.objects.roundness import directions
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.rotations import quat_to_matrix
from tossid.settings.training import TrainSettings
from tossid.training.restarts import Restart
from tossid.types import Phase, Toss

SEEN_REACH = 0.06
"""Height below which a learned corner touches the ground, as a share of half the width."""
SEEN_TURN = 0.087
"""Turn of the body since the last contact that counted, after which a touching corner counts again [rad]."""
SEEN_ANGLE = 0.2
"""Angle from the downward direction in a contact within which points of a round surface count as seen [rad]."""
FEWEST_SEEN = 3
"""Contacts of a learned corner from which on it counts as seen; of a round surface, frames."""
FRICTION_RANGE = (0.005, 5.0)
"""Friction outside of which training is said not to have converged: rollouts hardly depend on it there."""
STILL_FALLING = 0.01
"""Relative decrease of the validation loss over the last `patience` epochs, above which a stage that ended at its most
epochs is said not to have converged."""
COM_OUTSIDE, INERTIA_BEYOND = 0.02, 1.05
"""By how much a centre of mass may be outside the corners (widths), and an inertia beyond what is possible (ratio)."""


def seen_corners(model: ObjectModel, tosses: Sequence[Toss]) -> NDArray[np.bool_]:
    """Marks corners (n,) that contacts of tosses have shown.

    Frames in flight are no contacts, however low a corner is: one that is learned too far out sinks into the ground
    before the object lands. A body that lies still is one contact.

    Args:
        model: The object as it was learned.
        tosses: With true lengths.
    """
    reach = SEEN_REACH * 0.5 * model.width
    if model.roundness is not None:
        return _seen_directions(model, tosses, reach)
    count = np.zeros(model.n_corners, dtype=np.int64)
    for toss in tosses:
        q = toss.q[toss.phase != Phase.FLIGHT]
        touching = corner_heights(model, q) < reach
        down = -quat_to_matrix(body_poses(model, q)[1])[..., 2, :]
        for corner in np.flatnonzero((count < FEWEST_SEEN) & touching.any(axis=0)):
            downward = down[touching[:, corner], model.corner_body[corner]]
            count[corner] += turned(downward, SEEN_TURN).sum()
    return np.asarray(count >= FEWEST_SEEN)


def _seen_directions(model: ObjectModel, tosses: Sequence[Toss], reach: float) -> NDArray[np.bool_]:
    """Marks points of a round object's surface (`ObjectModel.as_points`) whose normal pointed down in contacts."""
    normals, found = directions(HULL_POINTS), []
    for body in sorted(set(model.corner_body.tolist())):
        own, down = model.corner_body == body, [np.zeros((0, 3))]
        for toss in tosses:
            q = toss.q[toss.phase != Phase.FLIGHT]
            touching = corner_positions(model, q)[:, own, 2].min(axis=1) < reach
            quat = body_poses(model, q[touching])[1][:, body]
            down.append(-quat_to_matrix(quat)[:, 2, :])
        near = normals @ np.concatenate(down).T > np.cos(SEEN_ANGLE)
        found.append(near.sum(axis=1) >= FEWEST_SEEN)
    return np.concatenate(found)


def geometry_report(
    model: ObjectModel, seen: NDArray[np.bool_], *, length_scale: float, history: Sequence[Any] = ()
) -> list[dict[str, Any]]:
    """The learned corners of each body, which of them tosses have shown, and from where they came.

    Args:
        model: The object as it was learned.
        seen: (n,), of `seen_corners`; of a round object, of the points of its surface.
        length_scale: Recorded length per true length.
        history: Corners (n_c, 3) before training and after each stage that moved them, true lengths; unused of round
            objects, whose corners stay.

    Returns:
        An entry a body: `vertices_m` in the recorded body frame, `seen`, and `way_m`, the vertices before training and
        after each stage that moved them; empty where none did.
    """
    if model.roundness is not None:
        model, history = model.as_points(), ()
    own = [model.corner_body == body for body in range(model.n_bodies)]
    corners = length_scale * model.corner_pos
    steps = [length_scale * np.array(step) for step in history] if len(history) > 1 else []
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
    reasons = [*_unfinished(history, settings), *_impossible(model)]
    low, high = FRICTION_RANGE
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
        most = settings.rollout_epochs if stage.startswith("rollout") else settings.epochs
        losses = [record.validation_loss for record in records]
        earlier = min(losses[: -settings.patience], default=losses[0])
        if records[-1].epoch >= most and min(losses) < earlier * (1 - STILL_FALLING):
            found.append(f"stage {stage} ended after {most} epochs while its loss still fell")
    return found


def _impossible(model: ObjectModel) -> list[str]:
    """Centres of mass and moments of inertia that no mass within the corners has."""
    found = []
    for body in range(model.n_bodies):
        drawn = model.drawn
        corners, name = drawn.corner_pos[drawn.corner_body == body], model.body_names[body]
        if len(corners) < 4:
            continue
        if protrusion(model.com[body : body + 1], corners)[0] > COM_OUTSIDE * model.width:
            found.append(f"the centre of mass of {name} lies outside its corners")
        reach = np.linalg.norm(corners - model.com[body], axis=1).max()
        if np.trace(model.inertia[body]) > 2 * model.mass[body] * reach**2 * INERTIA_BEYOND:
            found.append(f"{name} has more inertia than its mass at its farthest corner would have")
    return found


def size_contradiction(found: MeasurementEstimate, used: MeasurementModel) -> dict[str, Any] | None:
    """What tosses at rest say against the stated size of an object.

    A body that stands on its lowest face shows its height. Recorded height over stated height is either a wrong stated
    size or a wrong unit of the recording: tosses cannot tell which.

    Args:
        found: Of the training tosses, with the stated object.
        used: How the model takes recorded motion.

    Returns:
        {"shown_over_stated", "ci95", "n_at_rest", "length_scale", "warning": text}; None where too few tosses stand
        still, where the interval holds 1, or where the difference is within the limit.
    """
    scale, low, high = (float(x) for x in (found.length_scale, *found.length_scale_ci95))
    if found.n_at_rest < FEWEST_TOSSES or abs(scale - 1) <= SIZE_WARNING or low <= 1 <= high:
        return None
    change = f"{100 * abs(scale - 1):.1f} % {'larger' if scale > 1 else 'smaller'}"
    ends = " to ".join(f"{end:.4f}" for end in (low, high))
    taken = (
        "the model takes recorded lengths as they are, and the learned corners take it up"
        if used.length_scale == 1.0
        else f"the model divides recorded lengths by {used.length_scale:.4f}; with model.length_scale=1 the learned "
        "corners take it up"
    )
    return {
        "shown_over_stated": scale,
        "ci95": [low, high],
        "n_at_rest": found.n_at_rest,
        "length_scale": used.length_scale,
        "warning": f"{found.n_at_rest} tosses at rest show the object {change} than stated (ratio {scale:.4f}, 95 % "
        f"interval {ends}): a wrong stated size, or a wrong unit of the recording; {taken}",
    }
