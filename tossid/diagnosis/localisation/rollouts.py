"""Rollouts of whole tosses from first states as their flight determines them, and their errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import moved_pose
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import Windows, steps_of
from tossid.motion import flight_states
from tossid.physics.effects import World
from tossid.rotations import geodesic_angle
from tossid.types import Toss

Array = NDArray[np.float64]


def toss_errors(tosses: Sequence[Toss], world: World, windows: Windows, *, n_threads: int = 1) -> Array:
    """(B, 2) mean distance [% of the object's width] and angle [deg] of rollouts from the recorded poses.

    Args:
        tosses: B, as recorded.
        world: The simulator; each toss begins at what its first flight determines in it (`first_states`).
        windows: Of these tosses.
        n_threads: Of the simulator.

    Returns:
        Means over frames; NaN where a rollout diverged.
    """
    stated = windows.stated or world.object
    runs = rolled_out(tosses, world, windows, n_threads=n_threads)
    return distances(runs, [toss.q for toss in tosses], stated.width)


def distances(runs: Sequence[Array], others: Sequence[Array], width: float) -> Array:
    """(B, 2) mean distances [% of a width] and angles [deg] over frames; NaN where a motion diverged.

    Args:
        runs: B motions (n, nq).
        others: B others, of as many frames each.
        width: Of the object [m].
    """
    out = np.empty((len(runs), 2))
    for row, (q, other) in enumerate(zip(runs, others, strict=True)):
        out[row, 0] = 100 * np.linalg.norm(q[:, :3] - other[:, :3], axis=1).mean() / width
        out[row, 1] = np.rad2deg(geodesic_angle(q[:, 3:7], other[:, 3:7])).mean()
    return out


def whole_motions(
    tosses: Sequence[Toss], world: World, first: tuple[Array, Array], windows: Windows, n_threads: int
) -> list[Array]:
    """Poses (n, nq) of each toss's frames in a world, from given first states.

    Args:
        tosses: B, whose frames count.
        world: The simulator.
        first: (B, nq) poses and (B, nv) velocities.
        windows: Of these tosses.
        n_threads: Of the simulator.
    """
    how = steps_of(world, windows.settings.simulation)
    return at_frames(tosses, first, windows.dt, partial(world.roll_out, **how, n_threads=n_threads))


def at_frames(
    tosses: Sequence[Toss], first: tuple[Array, Array], dt: float, roll_out: Callable[..., Array]
) -> list[Array]:
    """Poses (n, nq) of each toss's frames, of motions of any simulator from given first states.

    Args:
        tosses: B, whose frames count.
        first: (B, nq) poses and (B, nv) velocities.
        dt: Between ticks [s].
        roll_out: Of the simulator, called with first poses and velocities, `n_steps` (B,) and `dt`.
    """
    ticks = [toss.ticks(dt) for toss in tosses]
    runs = roll_out(*first, n_steps=np.array([each[-1] for each in ticks]), dt=dt)
    return [poses[each] for poses, each in zip(runs, ticks, strict=True)]


def rolled_out(tosses: Sequence[Toss], world: World, windows: Windows, *, n_threads: int = 1) -> list[Array]:
    """Poses (n, nq) of each toss's frames in a world, from what its first flight determines there (`first_states`).

    Args:
        tosses: As recorded.
        world: The simulator.
        windows: Of these tosses.
        n_threads: Of the simulator.
    """
    first = first_states(tosses, world, windows, n_threads=n_threads)
    return whole_motions(tosses, world, first, windows, n_threads)


def measured_again(tosses: Sequence[Toss], runs: Sequence[Array], *, draws: int, seed: int = 0) -> list[Toss]:
    """Tosses with other motions, measured with the same noise.

    Args:
        tosses: As recorded.
        runs: Poses (n, nq) of each one's frames, as of `rolled_out`.
        draws: How often each is measured.
        seed: Of the noise.

    Returns:
        Each with the name of the toss whose first state it has; without those that diverged.
    """
    rng, out = np.random.default_rng(seed), []
    for toss, q in zip(tosses, runs, strict=True):
        if not np.isfinite(q).all():
            continue
        cov = toss.measured[1]
        root = np.linalg.cholesky(cov + 1e-18 * np.eye(cov.shape[1]))
        for _ in range(draws):
            noise = (root @ rng.normal(size=(*cov.shape[:2], 1)))[..., 0]
            q_seen = moved_pose(q, noise)
            out.append(Toss(toss.name, toss.t, q_seen, toss.v, cov, toss.v_cov, toss.phase))
    return out


def first_states(tosses: Sequence[Toss], world: World, windows: Windows, *, n_threads: int = 1) -> tuple[Array, Array]:
    """Recorded first poses (B, nq) and velocities (B, nv) that each toss's first flight determines in a world.

    Where that is a few frames, a ballistic fit is taken; of an object with joints, which has none, the first window.

    Args:
        tosses: As recorded.
        world: The simulator.
        windows: Of these tosses.
        n_threads: Of the simulator.
    """
    begin = np.flatnonzero(windows.first == 0)
    if world.object.n_joints:
        # of the windows that begin with a toss, that of its first flight is the last
        begin = np.array([begin[windows.toss[begin] == i][-1] for i in range(len(tosses))])
        q, v = np.empty((len(tosses), world.object.nq)), np.empty((len(tosses), world.object.nv))
    else:
        begin, r = begin[windows.free[begin]], world.recording
        states = flight_states(tosses, world.object, gravity=world.gravity * r.length_scale / r.clock_rate**2)
        q, v = np.stack([s.q for s in states]), np.stack([s.v for s in states])
    if len(begin):
        kept, _, _ = linearise(windows.rows(begin), world, steps=6, restarts=1, n_threads=n_threads)
        q[kept.toss], v[kept.toss] = kept.at_q, kept.at_v
    return q, v
