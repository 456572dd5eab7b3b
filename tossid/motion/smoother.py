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
two sides share nothing but the position. The velocity at a frame is the one
after what happened since the frame before, as a simulator that starts there
needs it.

Contact is possible where the geometry says so, and wherever free flight cannot
explain the motion: a jump, or an object that does not fall. In flight S is the
largest that the innovations' likelihood admits, so that an unmodelled force
widens the covariances instead of bending the velocities.

Rauch, Tung, Striebel, AIAA J. 3 (1965); Student-t noise as a scale mixture:
Lange, Little, Taylor, JASA 84 (1989).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.rts import filter_forward, smooth
from tossid.motion.system import Batch, differences, linearise, noise_moments, pad, retract, unpad
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import PoseTrack

Array = NDArray[np.float64]

BATCH = 64
"""Tracks smoothed together; the first batch, drawn evenly, gives the density in flight."""
NEAR = 512
"""Tracks in a row of which batches of similar length are made."""
SEARCH_PASSES, DENSITY_PASSES, FINAL_PASSES = 6, 8, 6
"""Passes that find the contact intervals, then the density in contact, and that follow with both densities in place."""
NU = 3.0
"""Degrees of freedom of the accelerations in contact: heavy tails, as impacts and lying still are both common."""
S_CONTACT = 0.3
"""[m²/s³] their density between impacts, where contact is looked for: at 148 Hz the velocity changes by 0.7 g h in an
interval. After that it is the likeliest one of the tracks themselves, from `S_LEAST` to ten times as much, but for
jumps that the poses' noise hides: these may be in every interval."""
S_LEAST = 3e-3
"""[m²/s³] no object in contact moves more evenly."""
FEWEST = 50
"""Intervals of contact that tell it."""
JUMP = 1.0
"""[m/s] the first pass lets the velocity change so much in every interval."""
OPEN = 10.0
"""An interval whose density exceeds S_CONTACT so many times holds a jump, whatever the geometry says."""
SPILL = 0.03
"""Share of an interval's density that its neighbours have at least: which of them held the impact is not certain."""
CARRIED_OVER = 0.02
"""[s] over which the mean acceleration tells whether the ground carries the object."""
S_FLIGHT = 10.0 ** np.arange(-8.5, 0.5, 0.5)
"""[m²/s³] densities in flight that are tried; the least lets the velocity wander by 0.04 mm/s in half a second, as
poses to 5 µm can tell."""
LOG_LIKELIHOOD_SLACK = 0.5
"""By how much a likelihood may fall short of the best: one standard deviation."""


@dataclass(frozen=True, slots=True)
class Smoothed:
    """q (n, nq), v (n, nv), their covariances (n, nv, nv), and contact (n-1,): whether the interval after a
    frame was treated as possible contact."""

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


def smooth_tracks(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], *, gravity: float = GRAVITY
) -> list[Smoothed]:
    """Smooth tracks of one object.

    Args:
        tracks: poses.
        model: its corners say where contact can be, its inertia how it flies.
        q_cov: (n, nv, nv) measurement covariance of each track.
        gravity: [m/s²].
    """
    return list(smooth_in_turn(tracks, model, q_cov, gravity=gravity))


def smooth_in_turn(
    tracks: Sequence[PoseTrack], model: ObjectModel, q_cov: Sequence[Array], *, gravity: float = GRAVITY
) -> Iterator[Smoothed]:
    """`smooth_tracks` one by one, of more tracks than fit into memory: at most `NEAR` and a batch are kept."""
    density = None
    done: dict[int, Smoothed] = {}
    turn = 0
    for places in _batches([len(track.t) for track in tracks]):
        batch = pad([tracks[i] for i in places], model, [q_cov[i] for i in places])
        state = _find_contact(model, batch, gravity)
        if density is None:
            density = _flight_density(model, batch, state)
            least = max(S_LEAST, min(_hidden(model, batch), S_CONTACT))
            for _ in range(DENSITY_PASSES if state.contact.sum() >= FEWEST and least < S_CONTACT else 0):
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
    """Places of the tracks in batches: first an even sample of all, then the rest by length, `NEAR` after `NEAR`."""
    order = np.argsort(lengths, kind="stable")
    sample = np.unique(np.linspace(0, len(order) - 1, min(BATCH, len(order))).astype(int))
    rest = np.delete(order, sample)
    rows = [rest[rest // NEAR == row] for row in range(-(-len(order) // NEAR))]
    return [order[sample], *(row[k : k + BATCH] for row in rows for k in range(0, len(row), BATCH))]


def gyration(model: ObjectModel) -> float:
    """Radius of gyration [m] of the base about its centre of mass: it compares spins with speeds."""
    return float(np.sqrt(np.trace(model.inertia[0]) / 3 / model.mass[0]))


def _shape(model: ObjectModel) -> Array:
    """(nv,) what a density of 1 m²/s³ is for each coordinate: kinetic energy is shared evenly."""
    return np.concatenate([np.ones(3), np.full(model.nv - 3, gyration(model) ** -2)])


def _find_contact(model: ObjectModel, batch: Batch, gravity: float) -> _State:
    """Smooth as if contact were possible everywhere; it is where the geometry or the motion says so."""
    density = np.tile(S_CONTACT * _shape(model), (2, 1))
    nothing = np.zeros_like(batch.touch)
    state = _State(
        q=batch.q.copy(),
        v=differences(batch.q, batch.h),
        cov=np.zeros(0),
        contact=nothing,
        factor=JUMP**2 / batch.h / S_CONTACT,
        fall=np.full_like(batch.h, gravity),
    )
    for _ in range(SEARCH_PASSES):
        noise = _pass(model, batch, state, density)
        state.factor = _factor(noise, batch.h, density[1])
        carried = _carried(state.v, batch, gravity)
        state.fall = np.where(carried, 0.0, gravity)
    state.contact = batch.inside & (batch.touch | carried | (state.factor > OPEN))
    return state


def _pass(model: ObjectModel, batch: Batch, state: _State, density: Array) -> Array:
    """One linearisation and smoothing; returns E[w²] (n-1, b, nv) of the velocities' noise.

    Args:
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
    """The density [m²/s³] of velocity jumps no larger than three poses' noise makes them seem, 6 σ²/h² each, in the
    coordinate that is measured worst."""
    var = np.median(np.diagonal(batch.R, axis1=-2, axis2=-1)[batch.seen] / _shape(model), axis=0)
    return float(6 * var.max() / np.median(batch.h[batch.inside]) ** 3)


def _likelier(noise: Array, h: Array, density: Array, contact: NDArray[np.bool_], least: float) -> float:
    """By what the density of Student-t noise becomes likelier, given E[w²]: a step of expectation maximisation."""
    size = (noise / h[..., None] / density).sum(axis=-1)[contact]
    nv = noise.shape[-1]
    step = float(np.mean(size * (NU + nv) / (NU + size)) / nv)
    return float(np.clip(step, least / density[0], 10 * S_CONTACT / density[0]))


def _factor(noise: Array, h: Array, density: Array) -> Array:
    """1 / E[s_k] (n-1, b) of the Student-t noise, given E[w²], or a share of a neighbour's."""
    nv = noise.shape[-1]
    size = (noise / h[..., None] / density).sum(axis=-1)
    own = (NU + size) / (NU + nv)
    factor = own.copy()
    factor[1:] = np.maximum(factor[1:], SPILL * own[:-1])
    factor[:-1] = np.maximum(factor[:-1], SPILL * own[1:])
    return factor


def _carried(v: Array, batch: Batch, gravity: float) -> NDArray[np.bool_]:
    """Intervals (n-1, b) around which the object falls with less than half of gravity."""
    rise = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(np.diff(v[..., 2], axis=0), axis=0)])
    typical = float(np.median(batch.h[batch.inside]))
    reach = max(1, round(0.5 * CARRIED_OVER / typical))
    at = np.arange(len(batch.h))
    first, last = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(batch.h))
    time = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(batch.h, axis=0)])
    return (rise[last] - rise[first]) / (time[last] - time[first]) > -0.5 * gravity


def _flight_density(model: ObjectModel, batch: Batch, state: _State) -> Array:
    """Densities (2, nv) of flight and contact; that of flight from the likelihood of the innovations.

    Translation and rotation are judged apart. Of the densities tried it is the
    largest whose log-likelihood is within `LOG_LIKELIHOOD_SLACK` of the best.
    """
    shape = _shape(model)
    density = np.stack([S_FLIGHT[0] * shape, S_CONTACT * shape])
    flying = np.zeros_like(batch.seen)
    flying[1:] = batch.inside & ~state.contact
    if not flying.any():
        return density
    parts = (slice(0, 3), slice(3, model.nv))
    score = np.zeros((len(S_FLIGHT), len(parts)))
    factor = np.where(state.contact, state.factor, 1.0)
    for row, s in enumerate(S_FLIGHT):
        S = factor[..., None] * np.where(state.contact[..., None], density[1], s * shape)
        filtered = filter_forward(linearise(model, state.q, state.v, batch, S, state.fall))
        for column, part in enumerate(parts):
            e, P = filtered.innovation[flying][:, part], filtered.innovation_cov[flying][:, part, part]
            distance = (e * np.linalg.solve(P, e[..., None])[..., 0]).sum(axis=-1)
            score[row, column] = -0.5 * (distance + np.linalg.slogdet(P)[1]).sum()
    for column, part in enumerate(parts):
        admitted = score[:, column] >= score[:, column].max() - LOG_LIKELIHOOD_SLACK
        density[0, part] = S_FLIGHT[np.flatnonzero(admitted).max()] * shape[part]
    return density
