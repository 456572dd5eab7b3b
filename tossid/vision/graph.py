"""The pose graph: every pose of a scene at once, by what was seen and what was known before (GTSAM).

Variables are T_world_body of static bodies and, for each time step, of moving ones (of one that hangs on another, the
angle of its hinge), T_rig_cam and T_body_tag; what the set-up gives exactly is a constant. Factors are views
(`factors.view_factor`), priors with the noise that the set-up gives, measured lengths, and stillness. The time steps of
a long recording hang together only through what is static: where that is to be found, a sample of steps calibrates it
in one batch; the steps follow in windows, with it as their prior, so that memory does not grow with the graph.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.rotations import transform_inv
from tossid.vision.factors import NO_FLAWS, Flaws, Noise, View, measurement_factor, view_factor
from tossid.vision.initial import State, there
from tossid.vision.layout import Distance, chain, limbs
from tossid.vision.limbs import hinges_of, swing_limbs
from tossid.vision.optimise import marginals_of, optimise
from tossid.vision.priors import (
    STEPS,
    Prior,
    body_key,
    calibrates,
    camera_key,
    clock_key,
    joint_key,
    print_key,
    priors,
    tag_key,
)
from tossid.vision.scene import Scene
from tossid.vision.solution import Motion, Solution, unsolved

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WINDOW = 3000
"""Time steps that are optimised at once."""
ALONE = 60
"""As many where steps share nothing unknown: the slowest of them says how often all of them are linearised."""
EACH = 20
"""Of a longer recording, so many time steps of each tag and each camera, at least, calibrate these."""
PRINT = 0.01
"""By how much of its size a print is wider, higher, or twisted out of its plane, where that is to be found."""
CLOCK = 0.002
"""How well a clock's offset is known before the graph [s]."""


@dataclass(eq=False)
class _Built:
    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    fixed: dict[int, Array] = field(default_factory=dict)
    noise: Noise = field(default_factory=Noise)


def solve(
    scene: Scene,
    state: State,
    used: Bools,
    *,
    scale: float = 1.0,
    known: dict[int, Prior] | None = None,
    motion: Motion | None = None,
    covariances: bool = False,
    window: int = WINDOW,
    steps: Ints | None = None,
    flaws: Flaws = NO_FLAWS,
    solved: bool = False,
) -> Solution:
    """Optimise all poses that the used sightings bear on.

    Args:
        state: first poses. used: (d,) sightings to use. scale: corners' standard deviation over what they promise,
            for the covariances; the estimate itself keeps to the promise, which weighs against the priors.
        known: prior knowledge by key, by default that of the set-up. motion: during frames, by default none.
        covariances: whether to find them. steps: those to solve, by default all; the others are left as they are.
        flaws: of tags' prints and images. solved: the poses are the best already; only covariances are to be found.

    Raises:
        SolverError: the optimisation ended in something that is no number.
    """
    known = priors(scene) if known is None else known
    still = Motion([np.zeros((len(T), 6)) for T in state.world], np.zeros(len(scene.cameras)), _no(scene))
    motion = still if motion is None else motion
    steps = np.unique(scene.step[used]) if steps is None else steps
    solution = unsolved(state, motion.clock)
    together = calibrates(scene, known) or motion.free.any()
    window = window if together else min(window, ALONE)
    if len(steps) <= window:
        _batch(scene, solution, used, steps, known, motion, flaws, scale, covariances, statics=True, solved=solved)
        return solution
    learned: dict[int, Prior] = {}
    if together:
        motion, learned = _sampled(scene, solution, used, steps, known, motion, flaws, scale, window)
    for a in range(0, len(steps), window):
        own = steps[a : a + window]
        both = {**known, **learned}
        _batch(scene, solution, used, own, both, motion, flaws, scale, covariances, statics=False, solved=solved)
    for key, poses, covs, at in _statics(scene, solution):
        if key in learned:  # not as the last window has it
            poses[at], cov = learned[key].T, learned[key].cov
            covs[at] = 0.0 if cov is None else cov
    return solution


def _sampled(
    scene: Scene,
    solution: Solution,
    used: Bools,
    steps: Ints,
    known: dict[int, Prior],
    motion: Motion,
    flaws: Flaws,
    scale: float,
    window: int,
) -> tuple[Motion, dict[int, Prior]]:
    """What a sample of steps tells of all that is static, as knowledge for the rest."""
    sample = _spread(scene, used, steps, window)
    _batch(scene, solution, used, sample, known, motion, flaws, scale, True, statics=True)
    learned = {
        key: Prior(poses[at].copy(), covs[at].copy() if covs[at].any() else None)
        for key, poses, covs, at in _statics(scene, solution)
        if np.isfinite(covs[at]).all()
    }
    return Motion(motion.twist, solution.clock.copy(), _no(scene)), learned


def _spread(scene: Scene, used: Bools, steps: Ints, window: int) -> Ints:
    """Time steps all over a recording, with some of every tag's and every camera's."""
    chosen = [steps[np.linspace(0, len(steps) - 1, window).astype(np.int64)]]
    for index in (scene.tag, scene.camera):
        for i in np.unique(index[used]):
            own = np.unique(scene.step[used & (index == i)])
            chosen.append(own[np.linspace(0, len(own) - 1, min(EACH, len(own))).astype(np.int64)])
    return np.unique(np.concatenate(chosen))


def _no(scene: Scene) -> Bools:
    return np.zeros(len(scene.cameras), dtype=bool)


def _statics(scene: Scene, solution: Solution) -> list[tuple[int, Array, Array, int]]:
    """Of all that is static: key, array of poses, array of their covariances, and place in both."""
    state = solution.state
    slots = [(camera_key(c), state.camera, solution.camera_cov, c) for c in range(len(scene.cameras))]
    slots += [(tag_key(i), state.tag, solution.tag_cov, i) for i in range(len(scene.tags))]
    statics = [b for b, body in enumerate(scene.bodies) if body.is_static]
    return slots + [(body_key(b, 0), state.world[b], solution.world_cov[b], 0) for b in statics]


def _batch(
    scene: Scene,
    solution: Solution,
    used: Bools,
    steps: Ints,
    known: dict[int, Prior],
    motion: Motion,
    flaws: Flaws,
    scale: float,
    covariances: bool,
    *,
    statics: bool,
    solved: bool = False,
) -> None:
    """Optimise some steps at once, into the solution; `statics`: also what is static. `solved`: as in `solve`."""
    built = _build(scene, solution.state, used & np.isin(scene.step, steps), known, motion, flaws, statics=statics)
    values = built.values if solved else optimise(built.graph, built.values)
    built.noise.scale = scale
    marginals = marginals_of(built.graph, values) if covariances and values.size() else None
    state = solution.state
    slots = _statics(scene, solution)
    for b, body in enumerate(scene.bodies):
        for step in () if body.is_static or body.hinge is not None else steps:
            slots.append((body_key(b, int(step)), state.world[b], solution.world_cov[b], int(step)))
    for key, poses, covs, at in slots:
        if key in built.fixed:
            covs[at] = 0.0
        elif values.exists(key):
            poses[at] = values.atPose3(key).matrix()
            if marginals is not None:
                covs[at] = marginals.marginalCovariance(key)
    for root in range(len(scene.bodies)):
        if limbs(scene.bodies, root):
            swing_limbs(scene, solution, root, steps, values, marginals)
    for i in range(len(scene.tags)):
        if values.exists(print_key(i)):
            state.prints[i] = values.atPoint3(print_key(i))
    for c in map(int, np.flatnonzero(motion.free)):
        if values.exists(clock_key(c)):
            solution.clock[c] = values.atDouble(clock_key(c))
            if marginals is not None:
                solution.clock_sigma[c] = float(np.sqrt(marginals.marginalCovariance(clock_key(c))[0, 0]))


def _build(
    scene: Scene, state: State, rows: Bools, known: dict[int, Prior], motion: Motion, flaws: Flaws, *, statics: bool
) -> _Built:
    built, half = _Built(), scene.half
    built.noise.swell = flaws.swell
    free = flaws.printed if statics else frozenset()
    index = np.flatnonzero(rows)
    step_of, camera_of, body_of = scene.step[index], scene.camera[index], scene.body[scene.tag[index]]
    placed = there(state.camera)[camera_of] & there(state.tag)[scene.tag[index]]
    placed &= there(state.at(scene.rig[camera_of], step_of)) & there(state.at(body_of, step_of))
    chains = [chain(scene.bodies, b) for b in range(len(scene.bodies))]
    for b, (root, links) in enumerate(chains):
        for link in (root, *links) if links else ():  # nothing without what it hangs on
            placed &= there(state.world[link][step_of]) | (body_of != b)
    for group in _views(scene, index[placed]):
        first = group[0]
        c, step = int(scene.camera[first]), int(scene.step[first])
        rig, body = int(scene.rig[c]), int(scene.body[scene.tag[first]])
        keys = [_key(built, camera_key(c), state.camera[c], known)]
        root, links = chains[body]
        for b in (rig, root):
            at = 0 if scene.bodies[b].is_static else step
            keys.append(_key(built, body_key(b, at), state.world[b][at], known))
        if rig == body:  # its pose in the world does not matter
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
            float(scene.late[first]) - (0.0 if motion.free[c] else float(motion.clock[c])),
            _twist(motion, rig, step),
            _twist(motion, body, step),
            _clock(built, c, motion) if motion.free[c] else None,
            tuple(
                (_joint(built, scene, state, b, step), hinge)
                for b, hinge in zip(links, hinges_of(scene, links), strict=True)
            ),
            scene.grow[group],
            {
                tag_key(int(i)): (state.prints[i], _print(built, int(i), state.prints[i]) if i in free else None)
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
    _add_stillness(built, scene)
    if statics:
        _add_measurements(built, scene, state, known)
    return built


def _views(scene: Scene, index: Ints) -> list[Ints]:
    """Rows of each (step, camera, body)."""
    if not len(index):
        return []
    body = scene.body[scene.tag[index]]
    order = np.lexsort((index, body, scene.camera[index], scene.step[index]))
    index, body = index[order], body[order]
    label = np.stack([scene.step[index], scene.camera[index], body])
    return np.split(index, np.flatnonzero((np.diff(label, axis=1) != 0).any(axis=0)) + 1)


def _key(built: _Built, key: int, T: Array, known: dict[int, Prior]) -> int:
    """Make a pose a constant or a variable of the graph, once."""
    if key in built.fixed or built.values.exists(key):
        return key
    prior = known.get(key)
    if prior is not None and prior.exact:
        built.fixed[key] = prior.T
    else:
        built.values.insert(key, gtsam.Pose3(T))
    return key


def _wiggled(built: _Built, key: int, c: int, step: int, T: Array, wiggle: tuple[float, float]) -> int:
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


def _twist(motion: Motion, b: int, step: int) -> Array:
    twist = motion.twist[b]
    return np.asarray(twist[step if len(twist) > 1 else 0])


def _print(built: _Built, i: int, first: Array) -> int:
    """How a tag differs from a flat square of the stated size."""
    key = print_key(i)
    if not built.values.exists(key):
        built.values.insert(key, first)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, PRINT)
        built.graph.add(gtsam.PriorFactorPoint3(key, np.zeros(3), noise))
    return key


def _joint(built: _Built, scene: Scene, state: State, b: int, step: int) -> int:
    """The angle of a body's hinge in a step, first as the poses on its two sides have it."""
    key, hinge = joint_key(b, step), scene.bodies[b].hinge
    assert hinge is not None
    if not built.values.exists(key):
        parent = next(i for i, body in enumerate(scene.bodies) if body.name == hinge.parent)
        T_parent_body = transform_inv(state.world[parent][step]) @ state.world[b][step]
        built.values.insert(key, float(hinge.angle(T_parent_body)))
    return key


def _clock(built: _Built, c: int, motion: Motion) -> int:
    key = clock_key(c)
    if not built.values.exists(key):
        built.values.insert(key, float(motion.clock[c]))
        # what was found before the graph is near; a camera that never shares a step would tell nothing of its clock
        noise = gtsam.noiseModel.Isotropic.Sigma(1, CLOCK)
        built.graph.add(gtsam.PriorFactorDouble(key, float(motion.clock[c]), noise))
    return key


def _add_stillness(built: _Built, scene: Scene) -> None:
    for b, body in enumerate(scene.bodies):
        if body.stillness is None:
            continue
        translation, rotation = body.stillness
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([rotation, translation], 3))
        keys = [body_key(b, step) for step in range(len(scene.t))]
        keys = [key for key in keys if built.values.exists(key)]
        for before, after in itertools.pairwise(keys):
            built.graph.add(gtsam.BetweenFactorPose3(before, after, gtsam.Pose3(), noise))


def _add_measurements(built: _Built, scene: Scene, state: State, known: dict[int, Prior]) -> None:
    number = {tag.id: i for i, tag in enumerate(scene.tags)}
    for measurement in scene.measurements:
        ids = measurement.tags if isinstance(measurement, Distance) else (measurement.tag,)
        at = [number.get(tag_id, -1) for tag_id in ids]
        if min(at) < 0 or not all(there(state.tag[i]) and there(state.world[scene.body[i]][0]) for i in at):
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
