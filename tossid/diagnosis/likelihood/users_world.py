"""A world whose motions are those of a user's own simulator, with effects as changes on top.

With theirs for the user's simulator, and ours for tossid's own of the stated object without and with effects, a motion
from first states x is

    theirs(x) + (ours(x, effects) - ours(x, none)),

poses as differences in the tangent space. Without effects it is the user's simulator and nothing else, whatever x is.
So first states, their uncertainty and whole tosses are those of the simulator that is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.simulator_process import SimulatorProcess
from tossid.diagnosis.likelihood.windows import difference, moved_pose
from tossid.physics.effects import World

Array = NDArray[np.float64]

_MOST_KEPT = 20_000
"""Motions that are kept, by their first states: fits ask for the same ones with other values of effects."""
_LONG = 24
"""Frames beyond which motions are asked for in a call of their own."""


@dataclass
class Motions:
    """Motions of a user's simulator by first state, which are not asked for twice.

    Attributes:
        process: The simulator.
    """

    process: SimulatorProcess
    _kept: dict[bytes, Array] = field(default_factory=dict)

    def __call__(self, q: Array, v: Array, steps: NDArray[np.int64], dt: float) -> Array:
        """(B, T + 1, nq) poses; each is its last one beyond its own number of steps.

        Args:
            q: (B, nq) first configurations.
            v: (B, nv) first velocities.
            steps: (B,) frames after the first; T is the most of them.
            dt: Between frames [s].
        """
        out = np.empty((len(q), int(steps.max()) + 1, q.shape[1]))
        keys = [np.append(np.concatenate([a, b]), dt).tobytes() for a, b in zip(q, v, strict=True)]
        for chosen in (steps <= _LONG, steps > _LONG):
            kept, rows = self._kept, np.flatnonzero(chosen).tolist()
            missing = [row for row in rows if len(kept.get(keys[row], ())) <= steps[row]]
            if missing:
                if len(kept) + len(missing) > _MOST_KEPT:
                    kept = self._kept = {}
                    missing = rows
                made = self.process(q[missing], v[missing], int(steps[missing].max()), dt)
                kept.update((keys[row], motion) for row, motion in zip(missing, made, strict=True))
            for row in rows:
                motion = kept[keys[row]][: steps[row] + 1]
                out[row, : len(motion)], out[row, len(motion) :] = motion, motion[-1]
        return out


@dataclass(frozen=True)
class UsersWorld(World):
    """A world that a user's simulator moves.

    Attributes:
        motions: Of the simulator; its ground is z = 0.
        stated: The same world without effects, to which changes are relative.
    """

    motions: Motions | None = None
    stated: World | None = None

    @staticmethod
    def of(stated: World, process: SimulatorProcess) -> UsersWorld:
        """The user's simulator as a world.

        Args:
            stated: The object as it is stated, to which effects are added.
            process: The simulator.
        """
        return UsersWorld(stated.object, gravity=stated.gravity, motions=Motions(process), stated=stated)

    @property
    def same_everywhere(self) -> bool:
        """No: nothing is known of a user's simulator."""
        return False

    def flies_like(self, other: World) -> bool:
        """Whether free motion is the same in both: that of the same user's simulator, with the same changes.

        Args:
            other: Another world.
        """
        return isinstance(other, UsersWorld) and self.motions is other.motions and super().flies_like(other)

    def plain(self) -> World:
        """The same world in tossid's own simulator."""
        names = (name for name in World.__dataclass_fields__)
        return World(**{name: getattr(self, name) for name in names})

    def roll_out(self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, **how: Any) -> Array:
        """Recorded motions (B, T + 1, nq) from recorded first states (B, nq), (B, nv).

        Args:
            q0: First poses.
            v0: First velocities.
            n_steps: Frames, one number or one a motion; T is the most of them.
            dt: Between recorded frames, on the recording's clock [s].
            **how: As of `World.roll_out`, for the changes.
        """
        assert self.motions is not None
        assert self.stated is not None
        steps = np.array(np.broadcast_to(np.asarray(n_steps, dtype=np.int64), (len(q0),)))
        with_effects, none = self.plain(), replace(self.stated, recording=self.recording)
        q, v = none.to_ground(q0, v0)
        theirs = none.recorded_poses(self.motions(q, v, steps, dt / self.recording.clock_rate))
        if _same(with_effects, none):
            return theirs
        here = with_effects.roll_out(q0, v0, n_steps=steps, dt=dt, **how)
        there = none.roll_out(q0, v0, n_steps=steps, dt=dt, **how)
        return moved_pose(theirs, difference(here, there))


def _same(one: World, other: World) -> bool:
    """Whether two worlds are one: the same object, and numbers that are equal."""
    names = [name for name in World.__dataclass_fields__ if name != "object"]
    return one.object is other.object and all(getattr(one, name) == getattr(other, name) for name in names)
