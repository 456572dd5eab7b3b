"""The pose graph's variables, factors and first values (GTSAM).

Variables are T_world_body of static bodies and, for each time step, of moving ones; the hinge angles of bodies that
hang on others; T_rig_cam and T_body_tag; clocks and prints where they are to be estimated. Exactly known poses are
constants. Factors are views (`factors.view_factor`), the set-up's priors, and measured lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv
from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.factors import IDEAL_TAGS, Noise, TagModel, View, measurement_factor, view_factor
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import (
    STEPS,
    Prior,
    State,
    TimingModel,
    body_key,
    camera_key,
    clock_key,
    is_known,
    joint_key,
    print_key,
    tag_key,
)
from tossid.vision.setup.hinge import Hinge
from tossid.vision.setup.layout import chain

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CLOCK_SIGMA = 0.002
"""Standard deviation of a clock's offset before the graph, about what `clocks` finds it to [s]."""
PRINT_SIGMA = 0.01
"""Prior standard deviation by which a print is wider, higher, or twisted out of its plane, in shares of its size."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved.

    Attributes:
        scene: The sightings and the set-up.
        used: Sightings to use, (d,).
        known: Prior knowledge by key; of a plain problem, the set-up's (`state.priors`).
        settings: All settings of tracking.
        timing: Motion between a step and a frame's own time, and the clocks; None for none.
        tag_model: How tags differ from flat squares.
        scale: Standard deviation of corners over what their covariances say, for the poses' covariances. The poses
            themselves weigh corners against priors as the corners' covariances say.
        covariances: Whether to find them.
        solved: Whether the poses are optimal already, and only covariances are to be found.
    """

    scene: Scene
    used: Bools
    known: dict[int, Prior]
    settings: TrackSettings = TrackSettings()
    timing: TimingModel | None = None
    tag_model: TagModel = IDEAL_TAGS
    scale: float = 1.0
    covariances: bool = False
    solved: bool = False

    @property
    def shares_unknowns(self) -> bool:
        """Whether time steps share unknowns: something static is not exactly known."""
        scene, known = self.scene, self.known
        keys = [camera_key(c) for c in range(len(scene.cameras))] + [tag_key(i) for i in range(len(scene.tags))]
        keys += [body_key(b, 0) for b, body in enumerate(scene.bodies) if body.is_static]
        return not all(key in known and known[key].exact for key in keys)


@dataclass(eq=False)
class BuiltGraph:
    """A factor graph, first values of its variables, constant poses by key, and the noise that its factors share."""

    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    fixed: dict[int, Array] = field(default_factory=dict)
    noise: Noise = field(default_factory=Noise)


def build(problem: Problem, state: State, rows: Bools) -> BuiltGraph:
    """The factor graph of some sightings, with first values of its variables.

    Args:
        problem: What is to be solved.
        state: First poses; sightings with an unknown pose between camera and tag are left out.
        rows: Sightings, (d,).
    """
    scene, known = problem.scene, problem.known
    timing = problem.timing or TimingModel.none(scene)
    built, half = BuiltGraph(), scene.half
    built.noise.spread_sigma = problem.tag_model.spread_sigma
    free = problem.tag_model.prints
    chains = [chain(scene.bodies, b) for b in range(len(scene.bodies))]
    index = _placed(scene, state, np.flatnonzero(rows), chains)
    for group in _views(scene, index):
        first = group[0]
        c, step = int(scene.camera[first]), int(scene.step[first])
        rig, body = int(scene.rig[c]), int(scene.body[scene.tag[first]])
        keys = [_key(built, camera_key(c), state.camera[c], known)]
        root, links = chains[body]
        for b in (rig, root):
            at = 0 if scene.bodies[b].is_static else step
            keys.append(_key(built, body_key(b, at), state.world[b][at], known))
        if rig == body:  # its pose in the world cancels
            keys[1:] = [int(gtsam.symbol("i", 0))] * 2
            built.fixed[keys[1]] = np.eye(4)
        tags = tuple(_key(built, tag_key(int(i)), state.tag[i], known) for i in scene.tag[group])
        wiggle = scene.cameras[c].wiggle
        if wiggle is not None:
            keys[0] = _wiggled(built, keys[0], c, step, state.camera[c], wiggle)
        view = View(
            keys[0],
            keys[1],
            keys[2],
            tags,
            half[group],
            scene.seen[group],
            scene.whiten[group],
            scene.count[group],
            float(scene.delay[first]) - (0.0 if timing.free[c] else float(timing.clock[c])),
            _twist(timing, rig, step),
            _twist(timing, body, step),
            _clock(built, c, timing) if timing.free[c] else None,
            tuple(
                (_joint(built, scene, state, b, step), hinge)
                for b, hinge in zip(links, hinges_of(scene, links), strict=True)
            ),
            scene.edge_growth[group],
            {
                tag_key(int(i)): (
                    state.prints[i],
                    _print(built, int(i), state.prints[i]) if i in free else None,
                )
                for i in scene.tag[group]
                if i in free or state.prints[i].any()
            },
        )
        if view.joints or free or any(key not in built.fixed for key in (*keys, *tags)):
            built.graph.add(view_factor(view, built.fixed, built.noise))
    for key, prior in known.items():
        if built.values.exists(key) and prior.cov is not None:
            noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (prior.cov + prior.cov.T))
            built.graph.add(gtsam.PriorFactorPose3(key, gtsam.Pose3(prior.T), noise))
    _add_measurements(built, scene, state, known)
    return built


def _placed(scene: Scene, state: State, index: Ints, chains: list[tuple[int, list[int]]]) -> Ints:
    """Those rows of which all poses between camera and tag are known, hinges' bodies included."""
    step_of, camera_of, body_of = scene.step[index], scene.camera[index], scene.body[scene.tag[index]]
    placed = is_known(state.camera)[camera_of] & is_known(state.tag)[scene.tag[index]]
    placed &= is_known(state.at(scene.rig[camera_of], step_of)) & is_known(state.at(body_of, step_of))
    for b, (root, links) in enumerate(chains):
        for link in (root, *links) if links else ():
            placed &= is_known(state.world[link][step_of]) | (body_of != b)
    return np.asarray(index[placed])


def _views(scene: Scene, index: Ints) -> list[Ints]:
    """The rows of each (step, camera, body)."""
    if not len(index):
        return []
    body = scene.body[scene.tag[index]]
    order = np.lexsort((index, body, scene.camera[index], scene.step[index]))
    index, body = index[order], body[order]
    label = np.stack([scene.step[index], scene.camera[index], body])
    return np.split(index, np.flatnonzero((np.diff(label, axis=1) != 0).any(axis=0)) + 1)


def _key(built: BuiltGraph, key: int, T: Array, known: dict[int, Prior]) -> int:
    """The key of a pose, which is made a constant or a variable of the graph where it is neither yet."""
    if key in built.fixed or built.values.exists(key):
        return key
    prior = known.get(key)
    if prior is not None and prior.exact:
        built.fixed[key] = prior.T
    else:
        built.values.insert(key, gtsam.Pose3(T))
    return key


def _wiggled(built: BuiltGraph, key: int, c: int, step: int, T: Array, wiggle: tuple[float, float]) -> int:
    """A camera's own pose in a step, near its pose on the rig."""
    own = int(gtsam.symbol("w", c * STEPS + step))
    if built.values.exists(own):
        return own
    built.values.insert(own, gtsam.Pose3(T))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(wiggle, 3))
    if key in built.fixed:
        built.graph.add(gtsam.PriorFactorPose3(own, gtsam.Pose3(built.fixed[key]), noise))
    else:
        built.graph.add(gtsam.BetweenFactorPose3(key, own, gtsam.Pose3(), noise))
    return own


def _twist(timing: TimingModel, b: int, step: int) -> Array:
    twist = timing.twist[b]
    return np.asarray(twist[step if len(twist) > 1 else 0])


def _print(built: BuiltGraph, i: int, first: Array) -> int:
    """The key of a tag's print, a variable with a prior."""
    key = print_key(i)
    if not built.values.exists(key):
        built.values.insert(key, first)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, PRINT_SIGMA)
        built.graph.add(gtsam.PriorFactorPoint3(key, np.zeros(3), noise))
    return key


def _joint(built: BuiltGraph, scene: Scene, state: State, b: int, step: int) -> int:
    """The key of the angle of a body's hinge in a step; its first value is that of the poses on both sides."""
    key, hinge = joint_key(b, step), scene.bodies[b].hinge
    assert hinge is not None
    if not built.values.exists(key):
        parent = next(i for i, body in enumerate(scene.bodies) if body.name == hinge.parent)
        T_parent_body = transform_inv(state.world[parent][step]) @ state.world[b][step]
        built.values.insert(key, float(hinge.angle(T_parent_body)))
    return key


def _clock(built: BuiltGraph, c: int, timing: TimingModel) -> int:
    key = clock_key(c)
    if not built.values.exists(key):
        built.values.insert(key, float(timing.clock[c]))
        # the prior determines the clock of a camera that never shares a step with others
        noise = gtsam.noiseModel.Isotropic.Sigma(1, CLOCK_SIGMA)
        built.graph.add(gtsam.PriorFactorDouble(key, float(timing.clock[c]), noise))
    return key


def _add_measurements(built: BuiltGraph, scene: Scene, state: State, known: dict[int, Prior]) -> None:
    number = {tag.id: i for i, tag in enumerate(scene.tags)}
    for measurement in scene.measurements:
        at = [number.get(tag_id, -1) for tag_id, _ in measurement.points]
        if min(at) < 0 or not all(is_known(state.tag[i]) and is_known(state.world[scene.body[i]][0]) for i in at):
            continue
        keys = [
            (
                _key(built, body_key(int(scene.body[i]), 0), state.world[scene.body[i]][0], known),
                _key(built, tag_key(i), state.tag[i], known),
            )
            for i in at
        ]
        if any(key not in built.fixed for pair in keys for key in pair):
            half = [0.5 * scene.tags[i].size for i in at]
            built.graph.add(measurement_factor(measurement, keys, half, built.fixed))


def hinges_of(scene: Scene, links: list[int]) -> list[Hinge]:
    """The hinges of some bodies."""
    return [hinge for hinge in (scene.bodies[b].hinge for b in links) if hinge is not None]
