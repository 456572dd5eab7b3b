"""Two links on a hinge, tossed by an engine, as tracked poses of both: data for learning links from nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.tossed_shapes import ShapeTossSettings, noisy, toss
from tossid.motion.links import body_tracks
from tossid.objects import ObjectModel, corner_positions, object_from_mjcf
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate, quat_to_matrix
from tossid.types import PoseTrack

Array = NDArray[np.float64]

HALF = np.array([0.05, 0.025, 0.025])
"""Half the edges of each link [m], as published with dair_pll."""
MIDDLE = np.array([0.035, 0.0, 0.0])
"""The second link's middle from the hinge [m]."""
HINGE = np.array([-0.035, 0.06, 0.0])
"""The hinge in the first link's frame [m]; its axis is y."""
FRAMES = ((np.array([0.012, -0.02, 0.007]), np.array([0.4, -0.7, 0.2])), (np.array([-0.01, 0.006, 0.02]), np.zeros(3)))
"""Where a tracker's frame is in each link: origin [m], rotation vector [rad]."""


class TossedLinks(NamedTuple):
    """Two links that were tossed, with their truth.

    Attributes:
        first: Tracked poses of link 1, with noise.
        second: The same of link 2.
        truth: Poses of both links without noise.
        object: The elbow that was tossed: solid boxes.
        frames: Origin [m] and quaternion of each link's tracked frame in the link.
    """

    first: tuple[PoseTrack, ...]
    second: tuple[PoseTrack, ...]
    truth: tuple[tuple[PoseTrack, ...], ...]
    object: ObjectModel
    frames: tuple[tuple[Array, Array], ...]

    def hinge(self) -> tuple[Array, Array]:
        """The true hinge in link 2's tracked frame: a point of the axis [m], and the axis."""
        origin, quat = self.frames[1]
        back = quat_conj(quat)
        return quat_rotate(back, -origin), quat_rotate(back, self.object.joint_axis[1])

    def in_tracked_frames(self, hinged: ObjectModel) -> ObjectModel:
        """The true object in the tracked frames, over the hinge that a dataset has.

        Args:
            hinged: The dataset's object, for its hinge alone.
        """
        turn = [quat_to_matrix(quat_conj(quat)) for _, quat in self.frames]
        at, own = np.array([origin for origin, _ in self.frames]), self.object
        com = np.array([R @ c for R, c in zip(turn, own.com - at, strict=True)])
        inertia = np.array([R @ inner @ R.T for R, inner in zip(turn, own.inertia, strict=True)])
        bodies = own.corner_body
        corners = np.einsum("nij,nj->ni", np.array(turn)[bodies], own.corner_pos - at[bodies])
        return hinged.with_changes(
            mass=own.mass, com=com, inertia=inertia, corner_body=bodies, corner_pos=corners, friction=own.friction,
            width=own.width,
        )  # fmt: skip


def toss_links(settings: ShapeTossSettings | None = None) -> TossedLinks:
    """Tosses of an elbow of two solid boxes, each link tracked in a frame of its own; `mass` is that of each link."""
    settings = settings or ShapeTossSettings()
    size, middle, hinge = (" ".join(f"{x:g}" for x in values) for values in (HALF, MIDDLE, HINGE))
    text = f"""<mujoco model="elbow">
  <worldbody>
    <body name="elbow_1">
      <freejoint/>
      <geom name="first" type="box" size="{size}" mass="{settings.mass}"/>
      <body name="elbow_2" pos="{hinge}">
        <joint name="hinge" type="hinge" axis="0 1 0"/>
        <geom name="second" type="box" size="{size}" pos="{middle}" mass="{settings.mass}"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
    model, rng = object_from_mjcf(text, friction=settings.friction, width=0.1), np.random.default_rng(settings.seed)
    truth = toss(model, lambda q: float(corner_positions(model, q)[:, 2].min()), rng, settings)
    frames = tuple((origin, quat_exp(turn)) for origin, turn in FRAMES)
    exact = tuple(
        tuple(_seen_from(track, frame) for track in tracks)
        for tracks, frame in zip(body_tracks(model, truth), frames, strict=True)
    )
    first, second = (tuple(noisy(track, rng) for track in tracks) for tracks in exact)
    return TossedLinks(first, second, exact, model, frames)


def _seen_from(track: PoseTrack, frame: tuple[Array, Array]) -> PoseTrack:
    """The track of a frame that is fixed in a link."""
    origin, turn = frame
    place = track.q[:, :3] + quat_rotate(track.q[:, 3:7], origin)
    return PoseTrack(track.name, track.t, np.concatenate([place, quat_mul(track.q[:, 3:7], turn)], axis=1))
