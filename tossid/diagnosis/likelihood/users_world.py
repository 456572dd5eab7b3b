"""A world whose motions are those of a user's own simulator, with effects as changes on top.

Without effects it is the user's simulator and nothing else, whatever the first state is. So first states, their
uncertainty and whole tosses are those of the simulator that is judged. With effects, its motion is changed frame by
frame from where it touches the ground (`step_changes`), and before that as a whole,

    theirs(x) + (ours(x, effects) - ours(x, none)),

poses as differences in the tangent space. In the air that is the same, for a small part of the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.nearest_contact import frames_of, nearest_contact
from tossid.diagnosis.likelihood.simulator_process import SimulatorProcess
from tossid.diagnosis.likelihood.step_changes import Contact, State, StepChanges
from tossid.errors import InputError
from tossid.objects import corner_heights
from tossid.physics.effects import World

Array = NDArray[np.float64]

_MOST_KEPT = 1_000_000
"""Frames of motions that are kept by their first states, the latest: fits ask for the same ones again."""
_TOGETHER = 2
"""Frames by which motions that are asked for in one call differ in length at most."""
_MOST_AT_ONCE = 10_000
"""Frames that are asked for in one call at most: how long a call may take is limited."""
_NEAR_GROUND = 5e-3
"""Height of the lowest corner [m] below which a motion is changed frame by frame, from two frames before on."""
_AT_REST, _QUIET = 3e-4, 4
"""Speed [m/s] below which a motion that is changed frame by frame is at rest after so many frames, and stays there."""
_AWAY, _SAME = np.array([0.37, -0.21, 0.0]), 1e-7
"""A way along the ground [m], and a difference [m, rad, m/s, rad/s] below which a frame is the same after it."""
_SLOWEST = 0.2
"""Speed of a first state from which on one frame shows how far an object moves [m/s]."""
_OTHER_CLOCK = 0.9
"""Time between frames, over the recorded one, with which a simulator is tried: a clock may be wrong by that."""
_FARTHEST = 1e3
"""[m], [m/s] or [rad/s] beyond which a motion has diverged."""


@dataclass
class Motions:
    """Motions of a user's simulator by first state, which are not asked for twice.

    Attributes:
        process: The simulator.
    """

    process: SimulatorProcess
    _kept: dict[bytes, State] = field(default_factory=dict)
    _frames: int = 0

    def __call__(self, q: Array, v: Array, steps: NDArray[np.int64], dt: float) -> State:
        """(B, T + 1, nq) configurations, (B, T + 1, nv) velocities; each stays beyond its own number of steps.

        Args:
            q: (B, nq) first configurations.
            v: (B, nv) first velocities.
            steps: (B,) frames after the first; T is the most of them.
            dt: Between frames [s].
        """
        keys = [row.tobytes() for row in np.column_stack([q, v, np.full(len(q), dt)])]
        known = [self._kept.get(key) for key in keys]
        lacking = np.array([run is None or len(run.q) <= n for run, n in zip(known, steps, strict=True)])
        frames = np.where(steps == 1, 1, -(-steps // _TOGETHER) * _TOGETHER)
        for length in np.unique(frames[lacking]).tolist():
            every = np.flatnonzero(lacking & (frames == length))
            for rows in np.array_split(every, max(1, -(-len(every) * length // _MOST_AT_ONCE))):
                made = State(*self.process(q[rows], v[rows], length, dt))
                for i, row in enumerate(rows.tolist()):
                    shorter = known[row]
                    self._frames += length - (0 if shorter is None else len(shorter.q) - 1)
                    known[row] = self._kept[keys[row]] = made.rows(i)
        if self._frames > _MOST_KEPT:  # the older half is forgotten
            for key in list(self._kept)[: len(self._kept) // 2]:
                self._frames -= len(self._kept.pop(key).q) - 1
        frame = np.minimum(np.arange(int(steps.max()) + 1), steps[:, None])
        runs = [run.rows(at) for run, at in zip(known, frame, strict=True) if run is not None]
        return State(np.stack([run.q for run in runs]), np.stack([run.v for run in runs]))

    def next(self, at: State, dt: float) -> State:
        """States a frame later.

        Args:
            at: (B, nq) configurations and (B, nv) velocities.
            dt: Of the frame [s].
        """
        return self(at.q, at.v, np.ones(len(at.q), dtype=np.int64), dt).rows((slice(None), 1))


@dataclass(frozen=True)
class UsersWorld(World):
    """A world that a user's simulator moves.

    Attributes:
        motions: Of the simulator; its ground is z = 0.
        stated: The same world without effects, to which changes are relative.
        by_frame: Whether changes are composed frame by frame in contact. It takes a simulator whose motion goes on from
            a state as it would have without a stop.
        contact: Of tossid's own that is nearest to the simulator's.
        level: Whether the simulator is the same wherever a motion begins along x and y.
    """

    motions: Motions = field(kw_only=True)
    stated: World = field(kw_only=True)
    by_frame: bool = True
    contact: Contact = Contact()
    level: bool = False

    @staticmethod
    def of(stated: World, process: SimulatorProcess) -> UsersWorld:
        """The user's simulator as a world.

        Args:
            stated: The object as it is stated, to which effects are added.
            process: The simulator.
        """
        return UsersWorld(stated.object, gravity=stated.gravity, motions=Motions(process), stated=stated)

    def prepared(
        self, first: State, steps: NDArray[np.int64], dt: float, *, most_lost: float, **how: Any
    ) -> UsersWorld:
        """The same with the nearest contact; with changes of whole motions only, where no motion goes on from a state.

        Args:
            first: States at which tosses begin.
            steps: (B,) frames of each.
            dt: Of a frame, in true time [s].
            most_lost: Largest `Frames.lost` of a motion that goes on from any state.
            **how: As of `World.roll_out`.
        """
        frames = frames_of(self.motions, self.motions.next, first, steps, dt, self.stated)
        away = self.motions.next(frames.before.shifted(_AWAY), dt).shifted(-_AWAY)
        level = bool(np.abs(away.minus(frames.after)).max(initial=0.0) < _SAME)
        if not frames.lost <= most_lost:
            return replace(self, by_frame=False, level=level)
        return replace(self, contact=nearest_contact(frames, self.stated, dt, **how), level=level)

    def check_clock(self, first: State, dt: float, about: str) -> None:
        """Refuse a user's simulator that does not take the time between frames as it is given.

        It may round it to time steps of its own: to none, where these are longer. Effects of the clock ask for other
        times.

        Args:
            first: States at which tosses begin, in flight.
            dt: Between frames [s].
            about: The simulator in words.

        Raises:
            InputError: In one frame, half of the tosses move less than half as far as their velocity says, or twice as
                far.
        """
        speed = np.linalg.norm(first.v[:, :3], axis=1)
        fast = speed > _SLOWEST
        for between in (dt, _OTHER_CLOCK * dt) if fast.any() else ():
            moved = np.linalg.norm(self.motions.next(first, between).q[:, :3] - first.q[:, :3], axis=1)
            share = float(np.median(moved[fast] / (between * speed[fast])))
            if not 0.5 < share < 2.0:
                raise InputError(
                    f"{about}: in one frame of dt = {between:.3g} s it moves the object {share:.2g} times as far as "
                    "its velocity says; does it round dt to time steps of its own? They must divide whatever dt it gets"
                )

    @property
    def same_everywhere(self) -> bool:
        """Whether the user's simulator and the changes are."""
        return self.level and super().same_everywhere

    def flies_like(self, other: World) -> bool:
        """Whether free motion is the same in both: that of the same user's simulator, with the same changes.

        Args:
            other: Another world.
        """
        return isinstance(other, UsersWorld) and self.motions is other.motions and super().flies_like(other)

    @property
    def by_first_states(self) -> World:
        """The stated object in tossid's own simulator, with the contact that is nearest to the user's.

        Derivatives lead to first states, and say how uncertain they are. The user's simulator would be asked for twelve
        motions for each of one window.
        """
        frames = {name: getattr(self, name) for name in ("recording", "ground_height", "ground_tilt")}
        return replace(self.contact.of(self.stated), **frames)

    def plain(self) -> World:
        """The same world in tossid's own simulator."""
        names = (name for name in World.__dataclass_fields__)
        return World(**{name: getattr(self, name) for name in names})

    def roll_out(
        self,
        q0: Array,
        v0: Array,
        *,
        n_steps: int | NDArray[np.int64],
        dt: float,
        near: tuple[Array, Array] | None = None,
        **how: Any,
    ) -> Array:
        """Recorded motions (B, T + 1, nq) from recorded first states (B, nq), (B, nv); NaN where one diverges.

        Args:
            q0: First poses.
            v0: First velocities.
            n_steps: Frames, one number or one a motion; T is the most of them.
            dt: Between recorded frames, on the recording's clock [s].
            near: First states (B, nq), (B, nv) that differ little. Where their motions stay in the air, the user's
                simulator is asked for those, and not for each that differs by as much as in ours.
            **how: As of `World.roll_out`, for the changes.
        """
        steps = np.array(np.broadcast_to(np.asarray(n_steps, dtype=np.int64), (len(q0),)))
        world, none = self.plain(), replace(self.stated, recording=self.recording)
        true_dt = dt / self.recording.clock_rate
        at_near = None if near is None else State(*world.to_ground(*near))

        def onward(
            q: Array, v: Array, n_steps: int | NDArray[np.int64], dt: float, at_near: State | None = None
        ) -> tuple[Array, Array]:
            # in the ground's frame, the ground is where the user's simulator has it
            changes = StepChanges(world, none, dt, how, self.contact)
            run = self._moved(State(q, v), np.broadcast_to(n_steps, (len(q),)), changes, at_near)
            return run.q, run.v

        run = onward(*world.to_ground(q0, v0), steps, true_dt, at_near)
        return world.recorded_motions(*run, n_steps=steps, dt=true_dt, onward=onward)

    def _moved(
        self, first: State, steps: NDArray[np.int64], changes: StepChanges, at_near: State | None = None
    ) -> State:
        """Motions in the ground's frame; in the air they may be found by those from states near by."""
        alike = _move_alike(changes.with_effects, changes.none)
        if alike and at_near is not None:
            return self._from_motions_near(first, steps, changes, at_near)
        theirs = self.motions(first.q, first.v, steps, changes.dt)
        if alike:
            return theirs
        begins = self._first_contact((theirs,), steps)
        # ours is needed until then, and shows whether it touches the ground before
        flown = np.minimum(begins + 1, steps) if self.by_frame else steps
        changed, plain = (changes.of_motions(first, flown, effects=effects) for effects in (True, False))
        some = theirs.rows((slice(None), slice(changed.q.shape[1])))
        run, start = theirs, some.plus(changed.minus(plain))
        run.q[:, : start.q.shape[1]], run.v[:, : start.q.shape[1]] = start.q, start.v
        before = self._first_contact((start, changed, plain), flown)
        begins = np.where(before < flown, np.minimum(before, begins), begins)
        rows = np.flatnonzero(begins < steps)
        if self.by_frame and len(rows):
            self._compose(run, begins, steps, rows, changes)
        return run

    def _from_motions_near(self, first: State, steps: NDArray[np.int64], changes: StepChanges, at_near: State) -> State:
        """Motions without changes. Until contact they differ from motions near by as much as in ours."""
        run = self.motions(at_near.q, at_near.v, steps, changes.dt)
        begins = self._first_contact((run,), steps)
        if not self.by_frame:
            begins = np.where(begins == steps, steps, 0)
        flown = np.maximum(begins, 1)
        # many differ from the same motion
        states = np.concatenate([at_near.q, at_near.v, flown[:, None]], axis=1)
        _, one, each = np.unique(states, axis=0, return_index=True, return_inverse=True)
        there = changes.of_motions(at_near.rows(one), flown[one], effects=False).rows(each.ravel())
        ours = changes.of_motions(first, flown, effects=False)
        moved = run.rows((slice(None), slice(ours.q.shape[1]))).plus(ours.minus(there))
        begins = np.minimum(begins, self._first_contact((ours, moved), begins))
        in_air = np.arange(ours.q.shape[1]) <= begins[:, None]
        for whole, part, initial in ((run.q, moved.q, first.q), (run.v, moved.v, first.v)):
            whole[:, : part.shape[1]][in_air] = part[in_air]
            whole[:, 0] = initial
        self._go_on(run, begins, steps, changes.dt)
        return run

    def _go_on(self, run: State, begins: NDArray[np.int64], steps: NDArray[np.int64], dt: float) -> None:
        """Motions of the user's simulator from frames `begins` on, in place."""
        rows = np.flatnonzero(begins < steps)
        if not len(rows):
            return
        at, left = run.rows((rows, begins[rows])), (steps - begins)[rows]
        parts = self.motions(at.q, at.v, left, dt)
        for i, row in enumerate(rows.tolist()):
            some = slice(begins[row] + 1, steps[row] + 1)
            run.q[row, some], run.v[row, some] = parts.q[i, 1 : left[i] + 1], parts.v[i, 1 : left[i] + 1]

    def _first_contact(self, motions: Sequence[State], steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """(B,) frames from which motions are changed frame by frame; `steps` where they stay in the air until then."""
        low = np.min([corner_heights(self.object, each.q).min(axis=-1) for each in motions], axis=0)
        near = ~(low > _NEAR_GROUND) & (np.arange(low.shape[1]) <= steps[:, None])
        return np.where(near.any(axis=1), np.maximum(near.argmax(axis=1) - 2, 0), steps)

    def _compose(
        self,
        run: State,
        begins: NDArray[np.int64],
        steps: NDArray[np.int64],
        rows: NDArray[np.int64],
        changes: StepChanges,
    ) -> None:
        """Motions `run` from `begins` on, in place."""
        quiet = np.zeros(len(steps), dtype=np.int64)
        ends = steps.copy()
        for frame in range(int(begins[rows].min()), int(steps[rows].max())):
            some = rows[(begins[rows] <= frame) & (frame < ends[rows])]
            if not len(some):
                continue
            sizes = np.maximum(np.abs(run.q[some, frame]).max(axis=1), np.abs(run.v[some, frame]).max(axis=1))
            good = some[sizes < _FARTHEST]
            run.q[some, frame + 1], run.v[some, frame + 1] = np.nan, np.nan
            ends[some[~(sizes < _FARTHEST)]] = frame + 1
            if len(good):
                at = run.rows((good, frame))
                on = self.motions.next(at, changes.dt)
                then = on.plus(changes(at, on))
                run.q[good, frame + 1], run.v[good, frame + 1] = then.q, then.v
                quiet[good] = np.where(np.abs(then.v * _scale(then.v)).max(axis=1) < _AT_REST, quiet[good] + 1, 0)
                ends[good] = np.where(quiet[good] >= _QUIET, np.minimum(frame + 1, steps[good]), ends[good])
        for row in rows:
            run.q[row, ends[row] + 1 :] = run.q[row, ends[row]]


def _scale(v: Array) -> Array:
    """(nv,) 1 of velocities, and 0.1 m of rates."""
    return np.array([1.0] * 3 + [0.1] * (v.shape[-1] - 3))


def _move_alike(one: World, other: World) -> bool:
    """Whether two worlds differ in no more than frames: in how motion is recorded, and how high the ground is."""
    alike = one.object is other.object and one.law == other.law and one.k_res is other.k_res
    alike = alike and np.array_equal(one.gravity_on_ground(), other.gravity_on_ground())
    forced = one.has_forces or other.has_forces
    return alike and (
        not forced or (one.forces_on_ground() == other.forces_on_ground() and one.registered == other.registered)
    )
