"""Tosses as training data: one row for each pair of neighbouring frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from tossid.errors import InputError
from tossid.motion.kinematics import com_velocities
from tossid.objects import ObjectModel, body_poses, corner_heights
from tossid.physics import make_system, tree_batch
from tossid.robust import NORMAL_MAD
from tossid.rotations import quat_to_matrix
from tossid.types import Toss


@dataclass(frozen=True)
class Transitions:
    """Transitions (q, v) -> (q', v'), N of them, and what of the kinematics the loss needs (float64).

    Attributes:
        dt: (N,) [s].
        v_next: (N, nv) velocity after it.
        dv: (N, nv) their difference.
        X: (N, n_b, 6, nv) body Jacobians before the step; this and the next four as in `physics.TreeBatch`.
        omega: (N, n_b, 3) bodies' spin.
        alpha: (N, n_b, 3) bodies' angular acceleration at zero dv/dt.
        xdd: (N, n_b, 3) acceleration of bodies' origins at zero dv/dt.
        R: (N, n_b, 3, 3) bodies' rotations.
        features: (N, n_f) the input of k_res, with the features of the world.
        instruments: (N, n_f) the same with the velocity of other frames of the flight; equal to `features` where there
            are none.
        z: (N,) height of the base's origin before the step [m].
        up_next: (N, n_b, 3) the world's vertical in each body's axes after the step.
        z_next: (N, n_b) height of each body's origin after the step [m].
        near: (K,) rows that may involve contact.
        flight: (F,) rows that surely do not: clear of the ground before and after, and accelerated as flights are.
    """

    dt: Tensor
    v_next: Tensor
    dv: Tensor
    X: Tensor
    omega: Tensor
    alpha: Tensor
    xdd: Tensor
    R: Tensor
    features: Tensor
    instruments: Tensor
    z: Tensor
    up_next: Tensor
    z_next: Tensor
    near: Tensor
    flight: Tensor

    def __len__(self) -> int:
        return len(self.dt)

    def rows(self, index: Tensor) -> Transitions:
        """The transitions of some rows, in that order.

        Args:
            index: (K,) rows.
        """
        parts = {name: value[index] for name, value in vars(self).items() if name not in ("near", "flight")}
        for name in ("near", "flight"):
            member = torch.zeros(len(self), dtype=torch.bool)
            member[getattr(self, name)] = True
            parts[name] = torch.nonzero(member[index]).flatten()
        return Transitions(**parts)

    def in_flight(self) -> Transitions:
        """The transitions that surely involve no contact, with instruments in place of features.

        The noise of v is in dv = v' - v, too. A regression of dv / dt on v finds a drag var(noise) / var(v) / dt that
        is not there: 0.4 / s, where speeds of 1 m/s are 0.05 m/s off at 148 Hz. The noise of other frames is not in dv
        (instrumental variables; Young, "Recursive Estimation and Time-Series Analysis", 2011).
        """
        rows = self.rows(self.flight)
        return replace(rows, features=rows.instruments)

    def free(self) -> Transitions:
        """The transitions that surely involve no contact, marked so: wrong corners below the ground do not count."""
        return replace(self.in_flight(), near=self.near[:0])


CONTACT_MARGIN, JOINTED_CONTACT_MARGIN = 0.25, 0.4
"""A transition may involve contact when a stated corner is, after it, lower than this share of the width. The stated
geometry of objects with joints is less exact: the published elbow's corners stop up to 2 cm above the ground."""
FLIGHT_CLEARANCE, JOINTED_FLIGHT_CLEARANCE = 0.1, 0.3
"""It is in flight when every stated corner stays higher than this share of the width. With 1 cm the published elbow
seems to fall at 8.4 m/s², with 3 cm at 9.8."""
OUTLIER_DEVIATIONS = 20.0
"""Robust standard deviations (1.48 median absolute deviations) from the median flight by which a flight's acceleration
may differ, along each axis; beyond, a hand or the ground had a part in it."""
OUTLIER_FLOOR = 0.5
"""Difference from the median flight that is accepted in any case [m/s²]: tosses without noise have no scatter."""
FRAMES_TO_INSTRUMENTS = 2
"""Frames between a transition and those of its instruments: a velocity that is the difference of two poses shares the
noise of one with its neighbour."""


def make_transitions(model: ObjectModel, tosses: Sequence[Toss]) -> Transitions:
    """All transitions of tosses.

    Args:
        model: The object, as it is stated.
        tosses: With true lengths.

    Raises:
        InputError: No toss, or tosses of another object (number of joints).
    """
    if not tosses:
        raise InputError("there are no tosses to learn from")
    for toss in tosses:
        if toss.q.shape[1] != model.nq:
            raise InputError(f"toss {toss.name} has {toss.q.shape[1]} coordinates, {model.name} has {model.nq}")
    q = np.concatenate([toss.q[:-1] for toss in tosses])
    v = np.concatenate([toss.v[:-1] for toss in tosses])
    q_next = np.concatenate([toss.q[1:] for toss in tosses])
    v_next = np.concatenate([toss.v[1:] for toss in tosses])
    batch, (x_next, quat_next) = tree_batch(make_system(model), q, v), body_poses(model, q_next)
    lowest = corner_heights(model, q_next).min(axis=1)
    jointed = model.n_joints > 0
    margin = (JOINTED_CONTACT_MARGIN if jointed else CONTACT_MARGIN) * model.width
    clearance = (JOINTED_FLIGHT_CLEARANCE if jointed else FLIGHT_CLEARANCE) * model.width
    clear = np.minimum(lowest, corner_heights(model, q).min(axis=1)) > clearance

    dt = np.concatenate([np.diff(toss.t) for toss in tosses])
    if clear.any():
        share = model.mass / model.mass.sum()
        a = (share @ com_velocities(model, q_next, v_next) - share @ com_velocities(model, q, v)) / dt[:, None]
        middle = np.median(a[clear], axis=0)
        scatter = NORMAL_MAD * np.median(np.abs(a[clear] - middle), axis=0)
        limit = np.maximum(OUTLIER_DEVIATIONS * scatter, OUTLIER_FLOOR)
        clear &= (np.abs(a - middle) <= limit).all(axis=1)
    index = np.concatenate([np.full(len(toss) - 1, i) for i, toss in enumerate(tosses)])
    instruments = _velocities_of_other_frames(v, v_next, clear, index)

    def tensor(array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array))

    return Transitions(
        dt=tensor(dt),
        v_next=tensor(v_next),
        dv=tensor(v_next - v),
        X=tensor(batch.X),
        omega=tensor(batch.omega),
        alpha=tensor(batch.alpha),
        xdd=tensor(batch.xdd),
        R=tensor(batch.R),
        features=tensor(batch.features),
        instruments=tensor(tree_batch(make_system(model), q, instruments).features),
        z=tensor(batch.x[:, 0, 2]),
        up_next=tensor(quat_to_matrix(quat_next)[:, :, 2, :]),
        z_next=tensor(x_next[:, :, 2]),
        near=tensor(np.flatnonzero(lowest < margin)),
        flight=tensor(np.flatnonzero(clear)),
    )


def _velocities_of_other_frames(v: np.ndarray, v_next: np.ndarray, clear: np.ndarray, toss: np.ndarray) -> np.ndarray:
    """Velocities (N, nv) of flights, each the mean of those of other frames, or the one there is.

    The other frames are `FRAMES_TO_INSTRUMENTS` before and after the transition.

    Args:
        v: (N, nv) before each transition.
        v_next: (N, nv) after it.
        clear: (N,) marks flight.
        toss: (N,) index of the toss.
    """
    flight = np.cumsum(~clear | (np.diff(toss, prepend=-1) != 0))  # each stretch of flight has a number of its own
    total, count = np.zeros_like(v), np.zeros((len(v), 1))
    together = (
        clear[:-FRAMES_TO_INSTRUMENTS]
        & clear[FRAMES_TO_INSTRUMENTS:]
        & (flight[:-FRAMES_TO_INSTRUMENTS] == flight[FRAMES_TO_INSTRUMENTS:])
    )
    total[FRAMES_TO_INSTRUMENTS:][together] += v[:-FRAMES_TO_INSTRUMENTS][together]
    total[:-FRAMES_TO_INSTRUMENTS][together] += v_next[FRAMES_TO_INSTRUMENTS:][together]
    count[FRAMES_TO_INSTRUMENTS:][together] += 1
    count[:-FRAMES_TO_INSTRUMENTS][together] += 1
    return np.where(count > 0, total / np.maximum(count, 1), v)
