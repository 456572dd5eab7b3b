"""Positions and velocities of a tracked object, with covariances, never smoothed across an impact.

The state is x = (p, R, joints; v, ω, joint rates) with the error
δ = (δp world, δθ body, δjoints; δv world, δω body, δrates), R = R̄ exp(δθ^); a
free body's p is its centre of mass. Between frames it moves as in free flight
(gravity, torque-free rotation), plus white accelerations of density S:

    δ_{k+1} = F_k δ_k + d_k + w_k,   w_k ~ N(0, S_k [[h³/3, h²/2], [h²/2, h]])

A velocity jump Δ at a time spread evenly over an interval of length h has
exactly that covariance, with S = Δ²/h. So one model covers flight, sliding
and impacts, if S may differ from interval to interval: w_k is Student-t
distributed, S_k = S / s_k with s_k ~ Gamma(ν/2, ν/2), and the s_k are found by
expectation maximisation around a Rauch-Tung-Striebel smoother (each pass
linearises anew), and S with them. Where an impact is, S_k becomes large: the velocities on its
two sides share nothing but the position. The velocity at a frame is the one after what happened since the frame before,
as a simulator that starts there needs it.

Contact is possible where the geometry says so, and wherever free flight cannot explain the motion: a jump, or an object
that does not fall. In flight, S is the largest that the innovations' likelihood admits, so that an unmodelled force
widens the covariances instead of biasing the velocities.

Rauch, Tung, Striebel, AIAA J. 3 (1965); Student-t noise as a scale mixture: Lange, Little, Taylor, JASA 84 (1989).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.contact import Touch
from tossid.motion.kinematics import gyration
from tossid.motion.smoothing.rts import filter_forward, smooth
from tossid.motion.smoothing.system import Batch, differences, linearise, noise_moments, pad, retract, unpad
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import PoseTrack

Array = NDArray[np.float64]

BATCH = 64
"""Tracks that are smoothed together; the first batch, drawn evenly, gives the densities."""
SORTED_TRACKS = 512
"""Tracks in a row of which batches of similar length are made."""
SEARCH_PASSES, DENSITY_PASSES, FINAL_PASSES = 6, 8, 6
"""Passes that find the intervals of contact, and the density in contact; and those with both in place."""
DOF = 3.0
"""Degrees of freedom of the Student-t accelerations; few, as impacts and lying still are both common."""
CONTACT_DENSITY = 0.3
"""Density of accelerations while contact is searched [m²/s³]: at 148 Hz the velocity changes by 0.7 g h in an interval.
After that it is estimated from the tracks, between the least and ten times this."""
LEAST_CONTACT_DENSITY = 3e-3
"""No object in contact moves more evenly [m²/s³]."""
FEWEST_CONTACTS = 50
"""Intervals of contact from which the density is estimated."""
FIRST_JUMP = 1.0
"""Change of velocity that the first pass allows in every interval [m/s]."""
JUMP_RATIO = 10.0
"""An interval holds a jump, whatever the geometry says, if its density is so many times `CONTACT_DENSITY`."""
NEIGHBOUR_SHARE = 0.03
"""Least share of an interval's density in its neighbours: it is not certain which of them held the impact."""
SUPPORT_TIME = 0.02
"""Time over which the mean acceleration shows whether the ground carries the object [s]."""
FLIGHT_DENSITIES = 10.0 ** np.arange(-8.5, 0.5, 0.5)
"""Densities in flight that are tried [m²/s³]. The least lets the velocity change by 0.04 mm/s in half a second, which
poses to 5 µm can show."""
LOG_LIKELIHOOD_SLACK = 0.5
"""The largest density whose log-likelihood is within this of the best is taken: one standard deviation."""


@dataclass(frozen=True, slots=True)
class Smoothed:
    """A smoothed track.

    Attributes:
        q: Configurations, (n, nq).
        v: Velocities, (n, nv).
        q_cov: Covariances of q in the tangent space, (n, nv, nv).
        v_cov: Covariances of v, (n, nv, nv).
        contact: Whether contact was possible in the interval after a frame, (n-1,).
    """

    q: Array
    v: Array
    q_cov: Array
    v_cov: Array
    contact: NDArray[np.bool_]


@dataclass(slots=True)
class _State:
    """What the passes change: reference q, v, contact (n-1, b), factor (n-1, b) on S, fall (n-1, b) [m/s²]."""

    q: Array
    v: Array
    cov: Array
    contact: NDArray[np.bool_]
    factor: Array
    fall: Array


def smooth_in_turn(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    q_cov: Sequence[Array],
    *,
    gravity: float = GRAVITY,
    touch: Touch | None = None,
) -> Iterator[Smoothed]:
    """Smoothed tracks of one object, one by one.

    Args:
        tracks: Poses.
        model: Its corners say where contact can be, its inertia how it flies.
        q_cov: Measurement covariance of each track, (n, nv, nv).
        gravity: [m/s²].
        touch: Says where contact can be instead, of an object without corners.

    Yields:
        The smoothed tracks in order; at most `SORTED_TRACKS` and a batch are in memory.
    """
    density = None
    done: dict[int, Smoothed] = {}
    turn = 0
    for places in _batches([len(track.t) for track in tracks]):
        batch = pad([tracks[i] for i in places], model, [q_cov[i] for i in places], touch)
        state = _find_contact(model, batch, gravity)
        if density is None:
            density = _flight_density(model, batch, state)
            least = max(LEAST_CONTACT_DENSITY, min(_hidden(model, batch), CONTACT_DENSITY))
            enough = state.contact.sum() >= FEWEST_CONTACTS and least < CONTACT_DENSITY
            for _ in range(DENSITY_PASSES if enough else 0):
                state.factor = np.where(state.contact, state.factor, 1.0)
                noise = _pass(model, batch, state, density)
                density[1] *= _likelier(noise, batch.h, density[1], state.contact, least)
                state.factor = _factor(noise, batch.h, density[1])
        state.factor = np.where(state.contact, state.factor, 1.0)
        for _ in range(FINAL_PASSES):
            noise = _pass(model, batch, state, density)
            state.factor = np.where(state.contact, _factor(noise, batch.h, density[1]), 1.0)
        for i, place in enumerate(places):
            arrays = unpad(batch, i, state.q, state.v, state.cov)
            done[int(place)] = Smoothed(*arrays, contact=state.contact[: len(arrays[0]) - 1, i].copy())
        while turn in done:
            yield done.pop(turn)
            turn += 1


def _batches(lengths: Sequence[int]) -> list[Array]:
    """Indices of the tracks in batches: an even sample of all first, then the rest in rows, each sorted by length."""
    size, row_size = BATCH, SORTED_TRACKS
    order = np.argsort(lengths, kind="stable")
    sample = np.unique(np.linspace(0, len(order) - 1, min(size, len(order))).astype(int))
    rest = np.delete(order, sample)
    rows = [rest[rest // row_size == row] for row in range(-(-len(order) // row_size))]
    return [order[sample], *(row[k : k + size] for row in rows for k in range(0, len(row), size))]


def _shape(model: ObjectModel) -> Array:
    """(nv,) densities of all coordinates that share kinetic energy evenly with 1 m²/s³ of the translation."""
    return np.concatenate([np.ones(3), np.full(model.nv - 3, gyration(model) ** -2)])


def _find_contact(model: ObjectModel, batch: Batch, gravity: float) -> _State:
    """The batch smoothed as if contact were possible everywhere, and where the geometry or the motion shows contact."""
    density = np.tile(CONTACT_DENSITY * _shape(model), (2, 1))
    state = _State(
        q=batch.q.copy(),
        v=differences(batch.q, batch.h),
        cov=np.zeros(0),
        contact=np.zeros_like(batch.touch),
        factor=FIRST_JUMP**2 / batch.h / CONTACT_DENSITY,
        fall=np.full_like(batch.h, gravity),
    )
    for _ in range(SEARCH_PASSES):
        noise = _pass(model, batch, state, density)
        state.factor = _factor(noise, batch.h, density[1])
        carried = _carried(state.v, batch, gravity)
        state.fall = np.where(carried, 0.0, gravity)
    state.contact = batch.inside & (batch.touch | carried | (state.factor > JUMP_RATIO))
    return state


def _pass(model: ObjectModel, batch: Batch, state: _State, density: Array) -> Array:
    """One linearisation and smoothing; returns E[w²] (n-1, b, nv) of the velocities' noise.

    density: (2, nv) of flight and of contact.
    """
    S = state.factor[..., None] * np.where(state.contact[..., None], density[1], density[0])
    system = linearise(model, state.q, state.v, batch, S, state.fall)
    mean, cov, lag = smooth(system)
    noise = noise_moments(system, mean, cov, lag)
    state.q, state.v = retract(state.q, state.v, mean)
    state.cov = cov
    return noise


def _hidden(model: ObjectModel, batch: Batch) -> float:
    """The density [m²/s³] of velocity jumps that the noise of three poses hides.

    Such a jump has the variance 6 σ²/h²; the coordinate with the largest noise counts.
    """
    var = np.median(np.diagonal(batch.R, axis1=-2, axis2=-1)[batch.seen] / _shape(model), axis=0)
    return float(6 * var.max() / np.median(batch.h[batch.inside]) ** 3)


def _likelier(noise: Array, h: Array, density: Array, contact: NDArray[np.bool_], least: float) -> float:
    """The factor by which a step of expectation maximisation changes the density of Student-t noise, given E[w²]."""
    size = (noise / h[..., None] / density).sum(axis=-1)[contact]
    nv = noise.shape[-1]
    # M-step: S <- mean of E[s_k] w_kᵀ w_k / nv, with E[s_k] = (ν + nv) / (ν + |w_k|²/S)
    step = float(np.mean(size * (DOF + nv) / (DOF + size)) / nv)
    return float(np.clip(step, least / density[0], 10 * CONTACT_DENSITY / density[0]))


def _factor(noise: Array, h: Array, density: Array) -> Array:
    """1 / E[s_k] (n-1, b) of the Student-t noise, given E[w²], or a share of a neighbour's."""
    nv = noise.shape[-1]
    size = (noise / h[..., None] / density).sum(axis=-1)
    own = (DOF + size) / (DOF + nv)  # E-step: 1 / E[s_k | w_k]
    factor = own.copy()
    factor[1:] = np.maximum(factor[1:], NEIGHBOUR_SHARE * own[:-1])
    factor[:-1] = np.maximum(factor[:-1], NEIGHBOUR_SHARE * own[1:])
    return factor


def _carried(v: Array, batch: Batch, gravity: float) -> NDArray[np.bool_]:
    """Intervals (n-1, b) around which the object falls with less than half of gravity."""
    rise = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(np.diff(v[..., 2], axis=0), axis=0)])
    typical = float(np.median(batch.h[batch.inside]))
    reach = max(1, round(0.5 * SUPPORT_TIME / typical))
    at = np.arange(len(batch.h))
    first, last = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(batch.h))
    time = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(batch.h, axis=0)])
    return (rise[last] - rise[first]) / (time[last] - time[first]) > -0.5 * gravity


def _flight_density(model: ObjectModel, batch: Batch, state: _State) -> Array:
    """Densities (2, nv) of flight and contact; that of flight from the likelihood of the innovations.

    Translation and rotation are judged apart. Of the densities tried, it is the largest whose log-likelihood is within
    the slack of the best.
    """
    tried, shape = FLIGHT_DENSITIES, _shape(model)
    density = np.stack([tried[0] * shape, CONTACT_DENSITY * shape])
    flying = np.zeros_like(batch.seen)
    flying[1:] = batch.inside & ~state.contact
    if not flying.any():
        return density
    parts = (slice(0, 3), slice(3, model.nv))
    score = np.zeros((len(tried), len(parts)))
    factor = np.where(state.contact, state.factor, 1.0)
    for row, s in enumerate(tried):
        S = factor[..., None] * np.where(state.contact[..., None], density[1], s * shape)
        filtered = filter_forward(linearise(model, state.q, state.v, batch, S, state.fall))
        for column, part in enumerate(parts):
            e, P = filtered.innovation[flying][:, part], filtered.innovation_cov[flying][:, part, part]
            distance = (e * np.linalg.solve(P, e[..., None])[..., 0]).sum(axis=-1)
            score[row, column] = -0.5 * (distance + np.linalg.slogdet(P)[1]).sum()
    for column, part in enumerate(parts):
        admitted = score[:, column] >= score[:, column].max() - LOG_LIKELIHOOD_SLACK
        # the largest that is admitted: too much noise widens covariances, too little biases velocities
        density[0, part] = tried[np.flatnonzero(admitted).max()] * shape[part]
    return density
