"""An object of which nothing is known: its start for training, from tracked poses alone.

The shape comes from the half-spaces that frames bound (`tossid.objects.convex_shape`), the centre of mass from free
fall (`tossid.motion.free_fall`), inertia and friction from the balance of momentum (`tossid.motion.momentum`) where it
determines them; where not, the inertia is that of an evenly filled shape. Training refines what is not sure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tossid.errors import InputError
from tossid.motion.free_fall import FreeFall, free_fall
from tossid.motion.momentum.estimate import Momentum, momentum_balance
from tossid.motion.parabola import find_parabola
from tossid.objects import GRAVITY, JointType, ObjectModel, to_mjcf
from tossid.objects.convex_shape import ConvexShape, find_shape
from tossid.objects.half_spaces import half_spaces
from tossid.settings.objects import UnknownObjectSettings
from tossid.types import Phase, PoseTrack, Toss

DISAGREEMENT = 1e-3
"""Height of the ground that the contacts of a polytope ask for, though it is z = 0, from which on its corners are not
sure, whatever their standard error [m]: edges are round, or the recording has errors that do not average out."""


class UnknownObject(NamedTuple):
    """What tracked poses show of an object.

    Attributes:
        object: The start for training.
        shape: Its corners with their certainty, and where it may reach further.
        fall: Its centre of mass and gravity.
        momentum: Its inertia and friction.
        off: How far the shape is above the ground at the end of each toss that rests elsewhere, by the toss's name [m].
    """

    object: ObjectModel
    shape: ConvexShape
    fall: FreeFall
    momentum: Momentum
    off: Mapping[str, float]

    def kept(self, settings: UnknownObjectSettings) -> dict[str, bool]:
        """Settings of a model that keep what the tosses have shown surely.

        Args:
            settings: The largest standard errors of what is kept.
        """
        agrees = abs(self.shape.ground[0]) < DISAGREEMENT
        corners = self.shape.roundness is not None or (self.shape.deviation.max() < settings.sure and agrees)
        com = self.fall.com_deviation.max() < settings.sure
        sure = {
            "learn_geometry": corners,
            "learn_com": com,
            "learn_inertia": com and self.momentum.inertia_deviation < settings.sure_inertia,
            "learn_friction": self.momentum.friction_deviation < settings.sure_friction,
        }
        return {name: False for name, is_sure in sure.items() if is_sure}

    def as_json(self) -> dict[str, Any]:
        """What was shown before training, with units in the names.

        `corners_m` are where training starts; `contacts` says how many different contacts show each of them, and
        `corner_deviation_m` how sure it is. `unseen_m` are points that the object may reach and no contact decides.
        """
        shape, fall = self.shape, self.fall
        return {
            "shape": shape.kind,
            "corners_m": shape.vertices.round(6).tolist(),
            "corner_deviation_m": [None if np.isinf(sd) else round(float(sd), 6) for sd in shape.deviation],
            "contacts": shape.frames.tolist(),
            "unseen_m": shape.unseen.round(6).tolist(),
            "misfit_m": shape.misfit,
            "rest_off_ground_m": dict(self.off),
            "ground_height_m": float(shape.ground[0]),
            "ground_slope": shape.ground[1:].round(6).tolist(),
            "com_m": fall.com.round(6).tolist(),
            "com_deviation_m": fall.com_deviation.round(6).tolist(),
            "gravity_ms2": fall.gravity,
            "gravity_deviation_ms2": fall.gravity_deviation,
            "mean_width_m": shape.mean_width,
            "inertia_deviation_rel": self.momentum.inertia_deviation,
            "friction": self.momentum.friction,
            "friction_deviation": None if self.momentum.friction is None else self.momentum.friction_deviation,
        }


def unknown_object(
    tosses: Sequence[Toss], settings: UnknownObjectSettings = UnknownObjectSettings(), *, gravity: float = GRAVITY
) -> UnknownObject:
    """The object that tosses show, with nothing stated but its mass.

    Args:
        tosses: Of one rigid body, in any body frame, over the ground z = 0.
        settings: The mass, and the friction to start from.
        gravity: By which flight is told from contact [m/s²].

    Raises:
        InputError: The tosses show no shape (too few sides, no contact), not one shape (the body's frame jumps), or no
            centre of mass (no flight), or the body has joints.
    """
    if tosses[0].q.shape[1] != 7:
        raise InputError("object=unknown is for one rigid body; these tosses have joints")
    flying = find_parabola([PoseTrack(toss.name, toss.t, toss.q) for toss in tosses], gravity=gravity)
    shape = find_shape(tosses, settings.shape, flying=[flying.flying(toss.t, toss.q) for toss in tosses])
    off = _off_ground(tosses, shape, settings)
    fall = free_fall(tosses, lambda toss: _clearance(toss, shape))
    _, _, inertia = shape.solid()
    model = ObjectModel(
        name=settings.name,
        body_names=(settings.name,),
        parent=np.array([-1]),
        joint_type=np.array([int(JointType.FREE)]),
        joint_pos=np.zeros((1, 3)),
        joint_axis=np.zeros((1, 3)),
        body_pos=np.zeros((1, 3)),
        body_quat=np.array([[1.0, 0.0, 0.0, 0.0]]),
        mass=np.array([settings.mass]),
        com=fall.com[None],
        inertia=settings.mass * inertia[None],
        corner_body=np.zeros(len(shape.corners), dtype=np.int64),
        corner_pos=shape.corners,
        roundness=shape.roundness,
        friction=settings.friction,
        restitution=0.0,
        width=shape.mean_width,
        tags=(),
        mjcf="",
    )
    momentum = momentum_balance(tosses, model, gravity=fall.gravity)
    if momentum.inertia_deviation < settings.sure_inertia:
        model = model.with_changes(inertia=momentum.inertia[None])
    if momentum.friction is not None and momentum.friction_deviation < settings.sure_friction:
        model = model.with_changes(friction=momentum.friction)
    return UnknownObject(model.with_changes(mjcf=to_mjcf(model)), shape, fall, momentum, off)


def rest_heights(tosses: Sequence[Toss], shape: ConvexShape) -> dict[str, float]:
    """Height of a shape's lowest point at the end of each toss that has come to rest, by the toss's name [m].

    Args:
        tosses: Of one rigid body, over the ground z = 0.
        shape: Its shape.
    """
    return {toss.name: float(_clearance(toss, shape)[-1]) for toss in tosses if toss.phase[-1] == Phase.REST}


def _off_ground(tosses: Sequence[Toss], shape: ConvexShape, settings: UnknownObjectSettings) -> dict[str, float]:
    """Height of the shape at the end of each toss that comes to rest well above or below the ground [m].

    Of a body frame that jumps between tosses, the half-spaces hold what both positions of the object share. So some of
    its faces hover at rest.

    Raises:
        InputError: Too many do.
    """
    height = rest_heights(tosses, shape)
    off = {name: z for name, z in height.items() if abs(z) > settings.rest_off_rel * shape.mean_width}
    if len(off) > max(1, settings.most_rest_off * len(height)):
        worst = 1e3 * max(map(abs, off.values()))
        raise InputError(
            f"no one shape rests on the ground: {len(off)} of {len(height)} tosses end up to {worst:.0f} mm above or "
            f"below it ({', '.join([*off][:3])}, …). Either the body's frame jumps between tosses, or they rest on "
            "something else than the ground z = 0"
        )
    return off


def _clearance(toss: Toss, shape: ConvexShape) -> np.ndarray:
    """Height of the shape's lowest point in each frame [m], (n,)."""
    spaces = half_spaces([toss])
    return np.asarray(spaces.height - shape.reach(spaces.down))
