"""Poses of a rigid body, or of bodies on joints, under Newton's and Euler's laws, with free impulses at the ground.

Between two frames the bodies fly, and each point that may touch the ground gets an impulse of which nothing is assumed:

    M(q) Δv = -bias(q, v) h + Σ_c J_cᵀ f_c.

An impulse is white over its interval, since nothing says when in the interval it acts. This is a linear Gaussian
system around the smoothed tosses. (Around what it finds itself, free impulses in neighbouring intervals grow against
each other.) With impulses of any size, the squared innovations of its Kalman filter are the
least squares of the measured poses over first states and impulses. So a parameter of the body that is wrong shows,
and a law of contact that is unknown does not: an engine with soft contact, or with another law of friction, gives
the same inertia.

Friction takes part where points slide steadily: there f_c = λ_c (e_z - μ s_c), with the direction s_c of sliding and
any λ_c. That is Coulomb's law of sliding, which laws of friction share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.motion.kinematics import corner_velocities
from tossid.motion.momentum.dynamics import TreeDynamics
from tossid.motion.smoothing.rts import LinearSystem, filter_forward
from tossid.motion.smoothing.system import difference, first_cov, moved, pad, white
from tossid.objects import ObjectModel, body_poses, corner_heights, lowest_points
from tossid.rotations import skew
from tossid.types import Phase, PoseTrack, Toss

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

NEAR, RESOLVED = 2e-3, 3e-4
"""Height of its way in an interval below which a point may touch the ground, and above which one that comes down has
not yet touched [m]."""
FREE_REL = 3.0
"""Standard deviation of a free impulse, in changes of momentum seen in its interval: large, so that it is free."""
FLIGHT_DENSITY, GYRATION = 1e-6, 0.03
"""Density of white acceleration in flight [m²/s³]: none, but for numerical reasons; radius by which spins count [m]."""
SLIDE_SPEED, SLIDE_COSINE = 0.12, 0.95
"""A point slides steadily that is faster than this [m/s], and whose direction turns by less in an interval."""
SLIDE_IMPULSE = 0.25
"""Change of the velocity, gravity apart, above which an interval holds an impact [m/s]."""
ACROSS_REL = 0.05
"""Standard deviation of the force across the direction of sliding, in sizes of a free impulse."""
REST_FRAMES = 5
"""Frames of final rest that take part: later ones say nothing."""


class Balance:
    """The measured poses of tosses against the balance of momentum.

    Args:
        tosses: Of one object over the ground z = 0, with smoothed velocities.
        model: Its corners, joints, centres of mass and masses.
        gravity: Of free flight, in recorded lengths [m/s²].

    Attributes:
        touching: (n - 1, b, n_c) points that may touch in each interval.
        sliding: (n - 1, b, n_c) those of them that slide steadily.
        frames: (b,) measured poses of each toss.
    """

    def __init__(self, tosses: Sequence[Toss], model: ObjectModel, gravity: float) -> None:
        self._gravity, self._model = gravity, model
        self._dynamics = TreeDynamics(model, gravity)
        moving = []
        for toss in tosses:
            awake = np.flatnonzero(toss.phase != Phase.REST)
            moving.append(toss.frames(slice((int(awake[-1]) if len(awake) else 0) + REST_FRAMES)))
        tracks, covs = zip(*(self._measured(toss) for toss in moving), strict=True)
        self._batch = pad(tracks, model.with_changes(com=np.zeros_like(model.com)), covs, touch=lambda t, _: t[1:] < 0)
        n, b = self._batch.seen.shape
        self._q, self._v = self._batch.q.copy(), np.zeros((n, b, model.nv))
        for i, toss in enumerate(moving):
            q, m = self._dynamics.about_com(toss.q), len(toss.t)
            self._q[:m, i], self._q[m:, i] = q, q[-1]
            self._v[:m, i, :3] = self._dynamics.com_velocity(toss.q, toss.v)
            self._v[:m, i, 3:] = toss.v[:, 3:]
        self.frames = self._batch.seen.sum(axis=0)
        self._begins = self._q[:-1].reshape(-1, model.nq), self._v[:-1].reshape(-1, model.nv), self._batch.h.ravel()
        self._F: Array | None = None
        self._size = FREE_REL * np.maximum(self._find_contacts(), 0.5 * gravity * self._batch.h)

    def linearise(self, inertia: Array) -> None:
        """Take the kinematics within intervals at this inertia, and the first time derivatives by the state.

        Args:
            inertia: (n_b, 3, 3) of each body about its centre of mass, in its frame [kg m²].
        """
        self._half_way = self._dynamics.half_way(*self._begins, inertia)
        if self._F is None:
            self._F = self._dynamics.transition(*self._begins, inertia)

    def residuals(self, inertia: Array, mu: float | None = None) -> Array:
        """Whitened innovations (n, b, nv), zero where there is no pose; their squares are the misfit.

        Args:
            inertia: As of `linearise`, which has to be called before.
            mu: Friction of the points that slide steadily; None for free impulses there, too.
        """
        found = filter_forward(self._system(inertia, mu))
        root = np.linalg.cholesky(found.innovation_cov)
        white = np.linalg.solve(root, found.innovation[..., None])[..., 0]
        return np.asarray(white * self._batch.seen[..., None])

    def _find_contacts(self) -> Array:
        """Find the points that touch in an interval, and where they are then.

        Returns:
            Changes of velocity, gravity apart, (n - 1, b) [m/s].
        """
        model, q, v, h = self._model, self._q, self._v, self._batch.h
        at_origin = self._dynamics.at_origin(q, v)
        height, velocity = corner_heights(model, at_origin[0]), corner_velocities(model, *at_origin)
        down = np.maximum(-velocity[:-1, ..., 2], 0)
        low = np.minimum(np.minimum(height[:-1], height[1:]), height[:-1] - down * h[..., None])
        self.touching = (low < NEAR) & self._batch.inside[..., None]
        # a point that comes down touches when it arrives, any other one in the middle of the interval
        falls = (height[:-1] > RESOLVED) & (down > 1e-3)
        when = np.where(falls, height[:-1] / np.maximum(down, 1e-3), np.inf)
        when = np.where(falls, np.minimum(when, h[..., None]), 0.5 * h[..., None])
        self._where = np.nonzero(self.touching)
        k, i, corner = self._where
        then, rate = moved(q[k, i], v[k, i] * when[self._where][:, None]), v[k, i]
        body = model.corner_body[corner]
        turn = body_poses(model, then)[1][:, model.corner_body]
        point = np.broadcast_to(lowest_points(model, turn), (*turn.shape[:-1], 3))[np.arange(len(k)), corner]
        self._then = at = self._dynamics.kinematics(then, rate)
        X, each = at.X, np.arange(len(k))
        self._jacobian = at.R[each, body] @ (X[each, body, 3:] - skew(point) @ X[each, body, :3])
        change = np.diff(v[..., :3], axis=0) + np.array([0.0, 0.0, self._gravity]) * h[..., None]
        impulse = np.linalg.norm(change, axis=-1)
        self._find_sliding(velocity[..., :2], impulse)
        return impulse

    def _find_sliding(self, velocity: Array, impulse: Array) -> None:
        """Sliding is steady where the same points slide straight on before, in and after an interval without impact."""
        touching = self.touching
        speed = np.linalg.norm(velocity, axis=-1)
        unit = velocity / np.maximum(speed, 1e-9)[..., None]
        fast = (speed[:-1] > SLIDE_SPEED) & (speed[1:] > SLIDE_SPEED)
        straight = (unit[:-1] * unit[1:]).sum(-1) > SLIDE_COSINE
        slides = touching & fast & straight
        steady = (slides == touching).all(-1) & touching.any(-1) & (impulse < SLIDE_IMPULSE)
        same = (touching[1:] == touching[:-1]).all(-1)
        inside = np.zeros_like(steady)
        inside[1:-1] = steady[2:] & steady[:-2] & same[1:] & same[:-1]
        self.sliding = slides & (steady & inside)[..., None]
        mean = unit[:-1] + unit[1:]
        self._direction = mean / np.maximum(np.linalg.norm(mean, axis=-1), 1e-9)[..., None]

    def _measured(self, toss: Toss) -> tuple[PoseTrack, Array]:
        """A toss's measured poses, about the common centre of mass, and their covariances (n, nv, nv)."""
        q, cov = toss.measured
        T = np.broadcast_to(np.eye(self._model.nv), cov.shape).copy()
        T[:, :3] = self._dynamics.com_jacobian(q)
        return PoseTrack(toss.name, toss.t, self._dynamics.about_com(q)), T @ cov @ T.swapaxes(-1, -2)

    def _system(self, inertia: Array, mu: float | None) -> LinearSystem:
        batch, h, nv = self._batch, self._batch.h, self._v.shape[-1]
        q, v = self._q, self._v
        q_next, v_next = self._dynamics.ahead(*self._begins, inertia, self._half_way)
        d = np.concatenate(
            [difference(q_next.reshape(q[1:].shape), q[1:]), v_next.reshape(v[1:].shape) - v[1:]], axis=-1
        )
        density = np.array([FLIGHT_DENSITY] * 3 + [FLIGHT_DENSITY / GYRATION**2] * (nv - 3))
        Q = white(np.broadcast_to(density, (*h.shape, nv)), h)
        # an impulse is white over its interval: it changes the velocity, and the place by half the interval's time
        cov, hh = self._by_contact(inertia, mu), h[..., None, None]
        Q[..., :nv, :nv] += cov * hh**2 / 3
        Q[..., :nv, nv:] += cov * hh / 2
        Q[..., nv:, :nv] += cov * hh / 2
        Q[..., nv:, nv:] += cov
        F = np.asarray(self._F).reshape(*h.shape, 2 * nv, 2 * nv)
        return LinearSystem(F, d, Q, difference(batch.q, q), batch.R, batch.seen, first_cov(nv))

    def _by_contact(self, inertia: Array, mu: float | None) -> Array:
        """Covariance of the changes of velocity by impulses, (n - 1, b, nv, nv)."""
        k, i, _ = self._where
        M = self._dynamics.mass_matrix(self._then, inertia)
        response = self._model.mass.sum() * np.linalg.solve(M, self._jacobian.swapaxes(-1, -2))
        response[:, :3] = np.eye(3)  # of the common centre of mass
        directions = np.broadcast_to(np.eye(3), (len(k), 3, 3)).copy()
        if mu is not None:
            # Coulomb: f = λ (e_z - μ s), and little across the direction of sliding s
            slides, s = self.sliding[self._where], self._direction[self._where]
            along = np.stack([-mu * s[:, 0], -mu * s[:, 1], np.ones(len(k))], axis=-1)
            across = np.stack([-s[:, 1], s[:, 0], np.zeros(len(k))], axis=-1)
            held = np.stack([along, ACROSS_REL * across, np.zeros((len(k), 3))], axis=-1)
            directions[slides] = held[slides]
        by = response @ directions * self._size[k, i][:, None, None]
        cov = np.zeros((*self._size.shape, by.shape[1], by.shape[1]))
        np.add.at(cov, (k, i), by @ by.swapaxes(-1, -2))
        return cov
