"""Some time steps of a scene as one least-squares problem: its unknowns, and its residuals.

The unknowns are T_world_body of static bodies and, for each time step, of moving ones; the hinge angles of bodies that
hang on others; T_rig_cam and T_body_tag; clocks and prints where they are to be estimated. Exactly known poses are
constants. Residuals are those of the sightings, of the set-up's priors, of measured lengths, and of stillness.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv
from tossid.vision.pose_graph.least_squares import Normal, normal_equations
from tossid.vision.pose_graph.reprojection import chain_of
from tossid.vision.pose_graph.resect import retract
from tossid.vision.pose_graph.residuals import (
    Rows,
    between_residuals,
    columns_of,
    length_residual,
    pose_residuals,
    sighting_residuals,
    value_residuals,
)
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import State, TimingModel, is_known
from tossid.vision.pose_graph.unknowns import Columns, Problem
from tossid.vision.setup.hinge import Hinge, Hinges
from tossid.vision.setup.layout import Measurement, chain

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CLOCK_SIGMA = 0.002
"""Standard deviation of a clock's offset before the graph, about what `clocks` finds it to [s]."""
PRINT_SIGMA = 0.01
"""Prior standard deviation by which a print is wider, higher, or twisted out of its plane, in shares of its size."""


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all unknowns of a batch of n steps.

    Attributes:
        state: Poses of the batch's steps.
        clock: Offsets of the clocks [s], (cameras,).
        angle: Of the hinge that each body hangs on, (bodies, n).
        mount: T_rig_cam in each step of cameras that wiggle, (cameras, n, 4, 4).
        swing: For each body that hangs on others, the derivative of its tangent by its root's and by the angles of its
            chain, (n, 6, 6 + m).
    """

    state: State
    clock: Array
    angle: Array
    mount: Array
    swing: dict[int, Array] = field(default_factory=dict)

    def hung(self, scene: Scene) -> Point:
        """The point with the bodies that hang on others where its roots and angles say."""
        for b, body in enumerate(scene.bodies):
            if body.hinge is not None:
                root, links = chain(scene.bodies, b)
                hinges = Hinges.of([hinge_of(scene, link) for link in links])
                ends = [
                    hinges.swing(T, list(angles))
                    for T, angles in zip(self.state.world[root], self.angle[links].T, strict=True)
                ]
                self.state.world[b] = np.stack([T for T, _ in ends])
                self.swing[b] = np.stack([J for _, J in ends])
        return self


class Batch:
    """Some time steps of a scene, to be solved together.

    Attributes:
        scene: Their sightings, with steps numbered from 0.
        columns: Of the unknowns.
        start: First values.
    """

    def __init__(self, problem: Problem, state: State, steps: Ints, *, statics: bool) -> None:
        """Collect what some time steps show.

        Args:
            problem: What is to be solved.
            state: First poses of all steps; sightings with an unknown pose between camera and tag are left out.
            steps: Which time steps, (n,).
            statics: Whether prints and measured lengths take part, too.
        """
        timing = problem.timing or TimingModel.none(problem.scene)
        index = np.flatnonzero(problem.used & np.isin(problem.scene.step, steps))
        scene = problem.scene.take(_placed(problem.scene, state, index))
        self.problem, self.scene = problem, replace(scene, step=np.searchsorted(steps, scene.step), t=scene.t[steps])
        world = [T[steps] if len(T) > 1 else T for T in state.world]
        self._timing = replace(timing, twist=[rate[steps] if len(rate) > 1 else rate for rate in timing.twist])
        self._measured = list(_measured(scene, state)) if statics else []
        free = np.isin(np.arange(len(scene.tags)), list(problem.tag_model.prints) if statics else [])
        self.columns = Columns.of(problem, self.scene, self._measured, free)
        angle = np.zeros((len(scene.bodies), len(steps)))
        for b in np.flatnonzero(self.columns.angle >= 0).tolist():
            hinge = hinge_of(scene, b)
            parent = next(i for i, body in enumerate(scene.bodies) if body.name == hinge.parent)
            angle[b] = hinge.angle(transform_inv(world[parent]) @ world[b])
        mount = np.repeat(state.camera[:, None], len(steps), axis=1)
        local = State(state.camera, state.tag, world, state.prints)
        self.start = Point(local.copy(), timing.clock, angle, mount).hung(scene)

    def error(self, point: Point) -> Array:
        """Half of the sum of squares: of each step where steps share nothing, (n,), else of all, (1,)."""
        n, still = len(self.scene.t), list(self._stillness(point))
        error = np.zeros(n)
        for rows in self._rows(point):
            error += 0.5 * np.bincount(rows.step, np.sum(rows.r**2, axis=1), minlength=n)
        if not self.columns.shared and not still:
            return error
        return np.array([error.sum() + 0.5 * sum(np.sum(r**2) for _, _, (r, _, _) in still)])

    def normal(self, point: Point, *, scale: float = 1.0) -> Normal:
        """The normal equations.

        Args:
            point: Where.
            scale: Standard deviation of corners over what their covariances say.
        """
        columns = self.columns
        out = normal_equations(self._rows(point, scale=scale), columns.shared, len(self.scene.t), columns.own)
        if any(body.stillness is not None for body in self.scene.bodies):
            out = replace(out, H_next=np.zeros((max(len(self.scene.t) - 1, 0), columns.own, columns.own)))
        for own, k, (r, J_a, J_b) in self._stillness(point):
            assert out.H_next is not None
            for at, J in ((k, J_a), (k + 1, J_b)):
                out.H_kk[at, own, own] += np.swapaxes(J, 1, 2) @ J
                out.g_k[at, own] += np.squeeze(np.swapaxes(J, 1, 2) @ r[..., None], -1)
            out.H_next[k, own, own] += np.swapaxes(J_a, 1, 2) @ J_b
        return out

    def moved(self, point: Point, step_s: Array, step_k: Array) -> Point:
        """The point after a step of what steps share (S,) and of each step's own (n, d)."""
        columns, state, mount = self.columns, point.state.copy(), point.mount.copy()
        clock, angle = point.clock.copy(), point.angle.copy()

        def update(poses: Array, first: Ints) -> None:
            moving = first >= 0
            poses[moving] = retract(poses[moving], step_s[columns_of(first[moving], 6)])

        update(state.camera, columns.camera)
        update(state.tag, columns.tag)
        for b, body in enumerate(self.scene.bodies):
            own = columns.body[b] - columns.shared
            if body.is_static:
                update(state.world[b], columns.body[b : b + 1])
            elif columns.angle[b] >= 0:
                angle[b] += step_k[:, columns.angle[b] - columns.shared]
            elif own >= 0:
                state.world[b] = retract(state.world[b], step_k[:, own : own + 6])
        for c in np.flatnonzero(columns.mount >= 0).tolist():
            own = columns.mount[c] - columns.shared
            mount[c] = retract(mount[c], step_k[:, own : own + 6])
        free, late = columns.print >= 0, columns.clock >= 0
        state.prints[free] += step_s[columns_of(columns.print[free], 3)]
        clock[late] += step_s[columns.clock[late]]
        return Point(state, clock, angle, mount).hung(self.scene)

    def sees(self, b: int) -> Bools:
        """In which steps a sighting depends on a moving body's pose, (n,)."""
        scene = self.scene
        tree = [one for one in range(len(scene.bodies)) if b in _path(scene, one)]
        rig, body = scene.rig[scene.camera], scene.body[scene.tag]
        rows = (np.isin(body, tree) | np.isin(rig, tree)) & (rig != body)
        return np.asarray(np.bincount(scene.step[rows], minlength=len(scene.t)) > 0)

    def _rows(self, point: Point, *, scale: float = 1.0) -> Iterator[Rows]:
        """All residuals but those of stillness."""
        scene, columns, state = self.scene, self.columns, point.state
        if len(scene.step):
            yield self._sightings(point, scale)
        yield from self._priors("camera", state.camera, columns.camera)
        yield from self._priors("tag", state.tag, columns.tag)
        static = np.where(columns.body < columns.shared, columns.body, -1)
        yield from self._priors("body", np.stack([T[0] for T in state.world]), static)
        prints, clocks = np.flatnonzero(columns.print >= 0), np.flatnonzero(columns.clock >= 0)
        yield value_residuals(state.prints[prints], 0.0 * state.prints[prints], PRINT_SIGMA, columns.print[prints])
        # the prior determines the clock of a camera that never shares a step with others
        late, before = point.clock[clocks, None], self._timing.clock[clocks, None]
        yield value_residuals(late, before, CLOCK_SIGMA, columns.clock[clocks])
        for c in np.flatnonzero(columns.mount >= 0).tolist():
            step = np.unique(scene.step[scene.camera == c])
            on_rig = np.broadcast_to(state.camera[c], (len(step), 4, 4))
            sigma = np.repeat(np.array(scene.cameras[c].wiggle), 3)
            r, J_rig, J_own = between_residuals(on_rig, point.mount[c][step], sigma)
            column = np.concatenate([columns_of(first[c : c + 1], 6)[0] for first in (columns.camera, columns.mount)])
            yield Rows(r, np.concatenate([J_rig, J_own], axis=2), np.tile(column, (len(step), 1)), step)
        for measurement, tags in self._measured:
            on = [int(scene.body[i]) for i in tags]
            r, J = length_residual(
                measurement,
                [state.world[b][0] for b in on],
                [state.tag[i] for i in tags],
                [0.5 * scene.tags[i].size for i in tags],
            )
            first = np.stack([columns.body[on], columns.tag[tags]], axis=1)
            yield Rows(
                np.array([[r]]), J.reshape(1, 1, -1), columns_of(first, 6).reshape(1, -1), np.zeros(1, dtype=int)
            )

    def _sightings(self, point: Point, scale: float) -> Rows:
        scene, columns, state = self.scene, self.columns, point.state
        step, rig, body = scene.step, scene.rig[scene.camera], scene.body[scene.tag]
        timing, wiggles = replace(self._timing, clock=point.clock), (columns.mount >= 0)[scene.camera]
        mounts = np.where(wiggles[:, None, None], point.mount[scene.camera, step], state.camera[scene.camera])
        seen = sighting_residuals(
            scene,
            chain_of(scene, state, timing, T_rig_cam=mounts),
            state.prints[scene.tag],
            rates=(timing.rate(rig, step), timing.rate(body, step)),
            scale=scale,
            spread_sigma=self.problem.tag_model.spread_sigma,
        )
        camera = np.where(wiggles, columns.mount[scene.camera], columns.camera[scene.camera])
        blocks = [(seen.camera, columns_of(camera, 6)), (seen.tag, columns_of(columns.tag[scene.tag], 6))]
        blocks += [self._by_root(point, seen.rig, rig, rig != body), self._by_root(point, seen.body, body, rig != body)]
        blocks += [(seen.print, columns_of(columns.print[scene.tag], 3))]
        blocks += [(-seen.delay, columns.clock[scene.camera][:, None])]
        blocks = [(J, column) for J, column in blocks if (column >= 0).any()]
        if not blocks:
            return Rows(seen.r, np.zeros((*seen.r.shape, 0)), np.zeros((len(step), 0), dtype=int), step)
        J, column = (np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True))
        return Rows(seen.r, J, column, step)

    def _by_root(self, point: Point, J: Array, body: Ints, counts: Bools) -> tuple[Array, Ints]:
        """Derivatives (d, 8, 6) by bodies' poses as derivatives by their roots' and hinges', with columns.

        counts: (d,), where a pose does not cancel, since camera and tag are on one body.
        """
        scene, columns = self.scene, self.columns
        longest = max((swing.shape[2] for swing in point.swing.values()), default=6)
        out, column = np.zeros((*J.shape[:2], longest)), np.full((len(J), longest), -1)
        out[..., :6], column[:, :6] = J, columns_of(columns.body[body], 6)
        for b, swing in point.swing.items():
            rows, n = body == b, swing.shape[2]
            out[rows, :, :n] = J[rows] @ swing[scene.step[rows]]
            column[rows, 6:n] = columns.angle[chain(scene.bodies, b)[1]]
        return out, np.where(counts[:, None], column, -1)

    def _priors(self, kind: str, poses: Array, first: Ints) -> Iterator[Rows]:
        """Residuals of the priors of unknowns of one kind."""
        unknown = np.flatnonzero(first >= 0).tolist()
        found = [(i, self.problem.known[kind, i]) for i in unknown if (kind, i) in self.problem.known]
        if found:
            own, mean = [i for i, _ in found], np.stack([prior.T for _, prior in found])
            cov = np.stack([np.asarray(prior.cov) for _, prior in found])
            yield pose_residuals(poses[own], mean, cov, first[own])

    def _stillness(self, point: Point) -> Iterator[tuple[slice, Ints, tuple[Array, Array, Array]]]:
        """Of each still body: its own columns, the steps from which it is tied to the next, and `between_residuals`."""
        for b, body in enumerate(self.scene.bodies):
            own = self.columns.body[b] - self.columns.shared
            if body.stillness is None or own < 0:
                continue
            seen = self.sees(b)
            k = np.flatnonzero(seen[:-1] & seen[1:])
            translation, rotation = body.stillness
            T, sigma = point.state.world[b], np.repeat([rotation, translation], 3)
            yield slice(own, own + 6), k, between_residuals(T[k], T[k + 1], sigma)


def hinge_of(scene: Scene, b: int) -> Hinge:
    """The hinge that a body hangs on."""
    hinge = scene.bodies[b].hinge
    assert hinge is not None
    return hinge


def _path(scene: Scene, b: int) -> list[int]:
    """A body and all that it hangs on, the root first."""
    root, links = chain(scene.bodies, b)
    return [root, *links]


def _measured(scene: Scene, state: State) -> Iterator[tuple[Measurement, list[int]]]:
    """Measured lengths between tags that are placed, with the tags' numbers."""
    number = {tag.id: i for i, tag in enumerate(scene.tags)}
    for measurement in scene.measurements:
        tags = [number.get(tag_id, -1) for tag_id, _ in measurement.points]
        if min(tags) >= 0 and all(is_known(state.tag[i]) and is_known(state.world[scene.body[i]][0]) for i in tags):
            yield measurement, tags


def _placed(scene: Scene, state: State, index: Ints) -> Ints:
    """Those rows of which all poses between camera and tag are known, hinges' bodies included."""
    step, camera, body = scene.step[index], scene.camera[index], scene.body[scene.tag[index]]
    placed = is_known(state.camera)[camera] & is_known(state.tag)[scene.tag[index]]
    placed &= is_known(state.at(scene.rig[camera], step)) & is_known(state.at(body, step))
    for b in np.flatnonzero([one.hinge is not None for one in scene.bodies]).tolist():
        for link in _path(scene, b):
            placed &= is_known(state.world[link][step]) | (body != b)
    return np.asarray(index[placed])
