"""Poses of a rigid body under Newton's and Euler's laws, with free impulses where it touches the ground.

Between two frames a body flies, and at each point r (from the centre of mass, in the body's frame) that may touch the
ground it gets an impulse of which nothing is assumed:

    m Δu = -m g h e_z + Σ_c f_c,        Δ(R I ω) = Σ_c R r_c × f_c.

An impulse is white over its interval, since nothing says when in the interval it acts. This is a linear Gaussian
system around a reference trajectory. With impulses of any size, the squared innovations of its Kalman filter are the
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
from tossid.motion.smoothing.rts import LinearSystem, filter_forward, smooth
from tossid.motion.smoothing.system import linearise, pad, retract
from tossid.objects import ObjectModel, corner_positions, lowest_points
from tossid.rotations import quat_exp, quat_mul, quat_rotate, quat_to_matrix, skew
from tossid.settings.motion import MomentumSettings
from tossid.types import Phase, PoseTrack, Toss

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

RESOLVED = 3e-4
"""Height above which a point that comes down has not yet touched [m]."""


class Balance:
    """The measured poses of tosses against the balance of momentum.

    Args:
        tosses: Of one rigid body over the ground z = 0, with smoothed velocities.
        model: Its corners, centre of mass and mass; its inertia is where the reference starts.
        gravity: Of free flight, in recorded lengths [m/s²].
        settings: What touches, and what slides.

    Attributes:
        touching: (n - 1, b, n_c) points that may touch in each interval.
        sliding: (n - 1, b, n_c) those of them that slide steadily.
        frames: (b,) measured poses of each toss.
    """

    def __init__(self, tosses: Sequence[Toss], model: ObjectModel, gravity: float, settings: MomentumSettings) -> None:
        self.settings, self._gravity = settings, gravity
        com = model.com[0]
        # the batch's origin is the centre of mass
        self._model = model.with_changes(com=np.zeros((1, 3)), corner_pos=model.corner_pos - com)
        moving = [toss.frames(slice(_until_rest(toss))) for toss in tosses]
        measured = [toss.measured for toss in moving]
        tracks = [PoseTrack(toss.name, toss.t, q) for toss, (q, _) in zip(moving, measured, strict=True)]
        self._batch = pad(tracks, model, [cov for _, cov in measured])
        n, b = self._batch.seen.shape
        self._q, self._v = self._batch.q.copy(), np.zeros((n, b, 6))
        for i, toss in enumerate(moving):
            m = len(toss.t)
            arm, turning = quat_rotate(toss.q[:, 3:7], com), np.cross(toss.v[:, 3:6], com)
            self._q[:m, i] = toss.q
            self._q[:m, i, :3] += arm
            self._q[m:, i] = self._q[m - 1, i]
            self._v[:m, i] = toss.v
            self._v[:m, i, :3] += quat_rotate(toss.q[:, 3:7], turning)
        self.frames = self._batch.seen.sum(axis=0)
        # from the smoothed velocities: free impulses would let their own size grow
        self._size = settings.free_rel * np.maximum(self._find(), 0.5 * gravity * self._batch.h)

    def move_reference(self, inertia: Array, times: int = 1) -> None:
        """Linearise about the trajectory that fits best with free impulses; find again what touches and slides.

        Args:
            inertia: (3, 3) about the centre of mass, in the body's frame [kg m²].
            times: How often.
        """
        for _ in range(times):
            mean, _, _ = smooth(self._system(inertia, None))
            self._q, self._v = retract(self._q, self._v, mean)
        self._find()

    def residuals(self, inertia: Array, mu: float | None = None) -> Array:
        """Whitened innovations (n, b, 6), zero where there is no pose; their squares are the misfit.

        Args:
            inertia: As of `move_reference`.
            mu: Friction of the points that slide steadily; None for free impulses there, too.
        """
        found = filter_forward(self._system(inertia, mu))
        root = np.linalg.cholesky(found.innovation_cov)
        white = np.linalg.solve(root, found.innovation[..., None])[..., 0]
        return np.asarray(white * self._batch.seen[..., None])

    def _find(self) -> Array:
        """Which points touch in an interval, and where they are then; returns changes of velocity (n - 1, b) [m/s]."""
        model, q, v, h, settings = self._model, self._q, self._v, self._batch.h, self.settings
        height, velocity = corner_positions(model, q)[..., 2], corner_velocities(model, q, v)
        down = np.maximum(-velocity[:-1, ..., 2], 0)
        low = np.minimum(np.minimum(height[:-1], height[1:]), height[:-1] - down * h[..., None])
        self.touching = (low < settings.near) & self._batch.inside[..., None]
        falls = (height[:-1] > RESOLVED) & (down > 1e-3)
        when = np.where(falls, height[:-1] / np.maximum(down, 1e-3), np.inf)
        when = np.where(falls, np.minimum(when, h[..., None]), 0.5 * h[..., None])
        turn = quat_mul(q[:-1, :, None, 3:7], quat_exp(v[:-1, :, None, 3:6] * when[..., None]))
        self._turn = quat_to_matrix(turn)
        arm = np.broadcast_to(lowest_points(model, turn), (*turn.shape[:-1], 3))
        self._lever = skew(arm)
        change = v[1:, :, :3] - v[:-1, :, :3] + np.array([0.0, 0.0, self._gravity]) * h[..., None]
        impulse = np.linalg.norm(change, axis=-1)
        self._find_sliding(velocity[..., :2], impulse)
        return impulse

    def _find_sliding(self, velocity: Array, impulse: Array) -> None:
        """Sliding is steady where the same points slide straight on before, in and after an interval without impact."""
        settings, touching = self.settings, self.touching
        speed = np.linalg.norm(velocity, axis=-1)
        unit = velocity / np.maximum(speed, 1e-9)[..., None]
        fast = (speed[:-1] > settings.slide_speed) & (speed[1:] > settings.slide_speed)
        straight = (unit[:-1] * unit[1:]).sum(-1) > settings.slide_cosine
        slides = touching & fast & straight
        steady = (slides == touching).all(-1) & touching.any(-1) & (impulse < settings.slide_impulse)
        same = (touching[1:] == touching[:-1]).all(-1)
        inside = np.zeros_like(steady)
        inside[1:-1] = steady[2:] & steady[:-2] & same[1:] & same[:-1]
        self.sliding = slides & (steady & inside)[..., None]
        mean = unit[:-1] + unit[1:]
        self._way = mean / np.maximum(np.linalg.norm(mean, axis=-1), 1e-9)[..., None]

    def _system(self, inertia: Array, mu: float | None) -> LinearSystem:
        batch, h, settings = self._batch, self._batch.h, self.settings
        model = self._model.with_changes(inertia=inertia[None])
        density = np.array([settings.flight_density] * 3 + [settings.flight_density / settings.gyration**2] * 3)
        S = np.broadcast_to(density, (*h.shape, 6))
        system = linearise(model, self._q, self._v, batch, S, np.full_like(h, self._gravity))
        # (n - 1, b, n_c, 6, 3): change of velocity by an impulse per mass in the world's axes
        turned = model.mass[0] * np.linalg.inv(inertia) @ self._lever @ self._turn.swapaxes(-1, -2)
        response = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=-2)
        free = self.touching if mu is None else self.touching & ~self.sliding
        by_free = response * (free * self._size[..., None])[..., None, None]
        cov = np.einsum("kbcij,kbclj->kbil", by_free, by_free)
        if mu is not None:
            way, zero = self._way, np.zeros((*self._way.shape[:-1], 1))
            along = np.concatenate([-mu * way, zero + 1.0], axis=-1)
            across = settings.across_rel * np.concatenate([-way[..., 1:], way[..., :1], zero], axis=-1)
            sizes = (self.sliding * self._size[..., None])[..., None, None]
            by_sliding = response @ np.stack([along, across], axis=-1) * sizes
            cov += np.einsum("kbcij,kbclj->kbil", by_sliding, by_sliding)
        hh = h[..., None, None]
        system.Q[..., :6, :6] += cov * hh**2 / 3
        system.Q[..., :6, 6:] += cov * hh / 2
        system.Q[..., 6:, :6] += cov * hh / 2
        system.Q[..., 6:, 6:] += cov
        return system


def _until_rest(toss: Toss) -> int:
    """Frames of a toss up to a few after it comes to rest: later ones say nothing."""
    moving = np.flatnonzero(toss.phase != Phase.REST)
    return min(len(toss.t), (int(moving[-1]) if len(moving) else 0) + 5)
