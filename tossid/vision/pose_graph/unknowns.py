"""What is to be solved, and where its unknowns stand in the normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.settings.tracking import TrackSettings
from tossid.vision.pose_graph.residuals import IDEAL_TAGS, TagModel
from tossid.vision.pose_graph.scene import Scene
from tossid.vision.pose_graph.state import Key, Prior, TimingModel
from tossid.vision.setup.layout import Measurement, chain, descendants

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved.

    Attributes:
        scene: The sightings and the set-up.
        used: Sightings to use, (d,).
        known: Prior knowledge of what is static; of a plain problem, the set-up's (`state.priors`).
        settings: All settings of tracking.
        timing: Motion between a step and a frame's own time, and the clocks; None for none.
        tag_model: How tags differ from flat squares.
        scale: Standard deviation of corners over what their covariances say, for the poses' covariances. The poses
            themselves weigh corners against priors as the corners' covariances say.
        covariances: Whether to find them.
    """

    scene: Scene
    used: Bools
    known: dict[Key, Prior]
    settings: TrackSettings = TrackSettings()
    timing: TimingModel | None = None
    tag_model: TagModel = IDEAL_TAGS
    scale: float = 1.0
    covariances: bool = False

    def is_constant(self, kind: str, i: int) -> bool:
        """Whether a pose is exactly known."""
        prior = self.known.get((kind, i))
        return prior is not None and prior.exact

    @property
    def shares_unknowns(self) -> bool:
        """Whether time steps share unknowns: something static is not exactly known, or stillness connects them."""
        scene = self.scene
        statics = [("camera", c) for c in range(len(scene.cameras))] + [("tag", i) for i in range(len(scene.tags))]
        statics += [("body", b) for b, body in enumerate(scene.bodies) if body.is_static]
        still = any(body.stillness is not None for body in scene.bodies)
        return still or not all(self.is_constant(*key) for key in statics)


@dataclass(frozen=True, eq=False)
class Columns:
    """First column of each unknown in a batch; -1 of a constant.

    What time steps share comes first. The columns from `shared` on are each step's own.

    Attributes:
        shared: Number of columns that steps share.
        own: Number of columns of each step.
        camera: Of T_rig_cam, (cameras,).
        tag: Of T_body_tag, (tags,).
        body: Of T_world_body of a static body; of a moving body, or of the root that it hangs on, in each step,
            (bodies,).
        angle: Of the hinge that each body hangs on, in each step, (bodies,).
        mount: Of T_rig_cam of a camera that wiggles, in each step, (cameras,).
        print: Of a tag's print, (tags,).
        clock: Of a camera's clock offset, (cameras,).
    """

    shared: int
    own: int
    camera: Ints
    tag: Ints
    body: Ints
    angle: Ints
    mount: Ints
    print: Ints
    clock: Ints

    @classmethod
    def of(cls, problem: Problem, scene: Scene, measured: list[tuple[Measurement, list[int]]], free: Bools) -> Columns:
        """The columns of the unknowns that any residual depends on.

        Args:
            problem: What is known exactly.
            scene: The batch's sightings.
            measured: Measured lengths, with the numbers of their tags.
            free: Whether a tag's print is unknown, (tags,).
        """
        bodies, at = scene.bodies, 0
        of_lengths = [i for _, tags in measured for i in tags]
        seen_camera, seen_tag = np.zeros(len(scene.cameras), dtype=bool), np.zeros(len(scene.tags), dtype=bool)
        seen_camera[scene.camera], seen_tag[scene.tag] = True, True
        seen_body, rig, body = np.zeros(len(bodies), dtype=bool), scene.rig[scene.camera], scene.body[scene.tag]
        for index in (rig[rig != body], body[rig != body], scene.body[of_lengths]):
            seen_body[[chain(bodies, int(b))[0] for b in np.unique(index)]] = True

        def first(wanted: Bools, size: int, kind: str = "") -> Ints:
            nonlocal at
            wanted = wanted & np.array([not problem.is_constant(kind, i) for i in range(len(wanted))], dtype=bool)
            columns = np.where(wanted, at + size * (np.cumsum(wanted) - 1), -1)
            at += size * int(wanted.sum())
            return columns

        camera = first(seen_camera, 6, "camera")
        tag = first(seen_tag | np.isin(np.arange(len(seen_tag)), of_lengths), 6, "tag")
        is_static = np.array([one.is_static for one in bodies])
        of_body = first(seen_body & is_static, 6, "body")
        print_ = first(seen_tag & free, 3)
        timing = problem.timing
        clock = first(seen_camera & (False if timing is None else timing.free), 1)
        shared, angle = at, np.full(len(bodies), -1)
        for root in np.flatnonzero(seen_body & ~is_static).tolist():
            of_body[root], at = at, at + 6
            for link in descendants(bodies, root):
                of_body[link], angle[link], at = of_body[root], at, at + 1
        mount = first(seen_camera & np.array([one.wiggle is not None for one in scene.cameras]), 6)
        return cls(shared, at - shared, camera, tag, of_body, angle, mount, print_, clock)

    def name_of(self, scene: Scene, column: int) -> str:
        """What a column is of, for a message."""
        kinds: list[tuple[str, Sequence[object], tuple[Ints, ...]]] = [
            ("camera", [one.name for one in scene.cameras], (self.camera, self.mount, self.clock)),
            ("tag", [one.id for one in scene.tags], (self.tag, self.print)),
            ("body", [one.name for one in scene.bodies], (self.angle, self.body)),
        ]
        ends = [
            (int(first[i]), f"{kind} {name}")
            for kind, names, firsts in kinds
            for first in firsts
            for i, name in enumerate(names)
        ]
        return max(end for end in ends if end[0] <= column)[1]
