"""An object of which nothing is known: its start for training, from tracked poses alone.

The shape comes from the half-spaces that frames bound (`tossid.objects.convex_shape`), the centre of mass from free
fall (`tossid.motion.free_fall`), friction from what slides (`tossid.motion.sliding`). The inertia is that of an evenly
filled shape. Training refines what is not sure.

Of two links on a hinge, each has a shape, and flight shows the parts of their common centre of mass
(`tossid.motion.links`). The mass ratio, on which no motion depends, is that of the volumes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.motion.free_fall import FreeFall, find_parabola, free_fall
from tossid.motion.links import body_tracks, com_of_moments, determined, moments_of_com
from tossid.motion.sliding import Sliding, sliding_friction
from tossid.objects import ObjectModel, to_mjcf, unstated_object
from tossid.objects.convex_shape import ConvexShape, find_shape
from tossid.objects.half_spaces import half_spaces
from tossid.objects.linked_shapes import contacts_alone, find_linked_shapes
from tossid.objects.unstated import hinge_of
from tossid.rotations import quat_rotate
from tossid.settings.objects import UnknownObjectSettings
from tossid.types import Phase, PoseTrack, Toss

DISAGREEMENT = 1e-3
"""Height of the ground that the contacts of a polytope ask for, though it is z = 0, from which on its corners are not
sure, whatever their standard error [m]: edges are round, or the recording has errors that do not average out."""
SURE = 3e-4
"""Standard error up to which corners, and the centre of mass, stay as the tosses showed them [m]: training would move
them to explain what its model lacks."""
SURE_FRICTION, FEWEST_SLIDING = 0.02, 4
"""Standard error up to which friction starts as sliding shows it, and tosses in which something slides."""
REST_OFF_REL, MOST_REST_OFF = 0.02, 0.1
"""Share of the mean width by which the shape may be above or below the ground when a toss has come to rest, and share
of the tosses at rest that may be farther off; from two on, more are refused: the body's frame jumps."""
ASSUMED = (
    "mass ratio: that of the volumes (no motion depends on it)",
    "centres of mass along the hinge: as nearly in the middle of the shapes as flight lets them be",
    "corners without contacts: within the extent of the others",
)
"""What no toss shows of two links."""


class UnknownObject(NamedTuple):
    """What tracked poses show of an object.

    Attributes:
        object: The start for training.
        shapes: Of each link: its corners with their certainty, and where it may reach further.
        alone: How many contacts show each corner of each link while no other link touches.
        fall: Its centre of mass and gravity.
        sliding: Its friction.
        off: How far the shape is above the ground at the end of each toss that rests elsewhere, by the toss's name [m].
    """

    object: ObjectModel
    shapes: tuple[ConvexShape, ...]
    alone: tuple[NDArray[np.int64], ...]
    fall: FreeFall
    sliding: Sliding
    off: Mapping[str, float]

    def kept(self) -> dict[str, bool]:
        """Settings of a model that keep what the tosses have shown surely."""
        sure = {
            "learn_geometry": all(_is_sure(shape, linked=len(self.shapes) > 1) for shape in self.shapes),
            "learn_com": self.fall.com_deviation.max() < SURE,
        }
        return {name: False for name, is_sure in sure.items() if is_sure}

    def as_json(self) -> dict[str, Any]:
        """What was shown before training, with units in the names.

        `corners_m` are where training starts; `contacts` says how many different contacts show each of them, and
        `corner_deviation_m` how sure it is. `unseen_m` are points that the object may reach and no contact decides. Of
        two links, these are in an entry a link under `links`, with `contacts_alone`: contacts while the other link is
        off the ground. `assumed` then names what no toss shows.
        """
        fall = self.fall
        links = [_link_json(*each) for each in zip(self.shapes, self.alone, strict=True)]
        ground = np.mean([shape.ground for shape in self.shapes], axis=0)
        if len(links) > 1:
            own: dict[str, Any] = {
                "shape": f"{len(links)} links",
                "links": links,
                "com_parts_m": fall.com.round(6).tolist(),
                "com_parts_deviation_m": fall.com_deviation.round(6).tolist(),
                "com_m": self.object.com.round(6).tolist(),
                "assumed": ASSUMED,
            }
        else:
            own = {
                **{name: value for name, value in links[0].items() if name != "contacts_alone"},
                "com_m": fall.com[0].round(6).tolist(),
                "com_deviation_m": fall.com_deviation[0].round(6).tolist(),
            }
        return {
            **own,
            "friction": self.sliding.friction if self.sliding.tosses else None,
            "friction_deviation": self.sliding.deviation if self.sliding.tosses > 1 else None,
            "rest_off_ground_m": dict(self.off),
            "ground_height_m": float(ground[0]),
            "ground_slope": ground[1:].round(6).tolist(),
            "gravity_ms2": fall.gravity,
            "gravity_deviation_ms2": fall.gravity_deviation,
            "mean_width_m": self.object.width,
        }


def unknown_object(
    tosses: Sequence[Toss],
    settings: UnknownObjectSettings = UnknownObjectSettings(),
    *,
    tree: ObjectModel | None = None,
) -> UnknownObject:
    """The object that tosses show, with nothing stated but its mass.

    Args:
        tosses: Of one rigid body, or of two links on a hinge, in any body frames, over the ground z = 0.
        settings: The mass, the number of links, and the friction to start from.
        tree: The dataset's object. Of two links its hinge is taken, which the tosses' angles are about; nothing else.

    Raises:
        InputError: The tosses show no shape (too few sides, no contact), not one shape (the body's frame jumps), or no
            centre of mass (no flight), or the number of links is another.
    """
    hinge = None if tree is None else hinge_of(tree)
    tree = unstated_object(hinge=hinge)
    if tosses[0].q.shape[1] != tree.nq or tree.n_bodies != settings.links:
        kind = "one rigid body" if settings.links == 1 else "two links on a hinge"
        raise InputError(f"object.links={settings.links} is {kind}; joints of these tosses: {tosses[0].q.shape[1] - 7}")
    flying = find_parabola([PoseTrack(toss.name, toss.t, toss.q) for toss in tosses], tree)
    free = {toss.name: flying.flying(toss.t, toss.q) for toss in tosses}
    shapes, alone = _shapes(tosses, tree, [free[toss.name] for toss in tosses])
    off = _off_ground(tosses, tree, shapes)

    def clearance(toss: Toss) -> NDArray[np.float64]:
        """Of links, whatever does not fall is left out: stretches above the ground hold hands and lost angles."""
        height = _clearance(toss, tree, shapes)
        return np.where(free[toss.name], height, 0.0) if tree.n_joints else height

    fall = free_fall(tosses, tree, clearance)
    model = _filled(tree, shapes, fall, settings)
    sliding = sliding_friction(tosses, model, gravity=fall.gravity)
    if _is_sure_of(sliding):
        model = model.with_changes(friction=sliding.friction)
    return UnknownObject(model.with_changes(mjcf=to_mjcf(model)), shapes, alone, fall, sliding, off)


def _is_sure_of(sliding: Sliding) -> bool:
    return sliding.tosses >= FEWEST_SLIDING and sliding.deviation < SURE_FRICTION


def _shapes(
    tosses: Sequence[Toss], tree: ObjectModel, flying: Sequence[NDArray[np.bool_]]
) -> tuple[tuple[ConvexShape, ...], tuple[NDArray[np.int64], ...]]:
    """The shape of each link, and how many contacts show each of its corners alone."""
    if not tree.n_joints:
        shape = find_shape(tosses, flying=flying)
        return (shape,), (shape.frames,)
    links = body_tracks(tree, tosses)
    axes = [quat_rotate(tree.body_quat[1], tree.joint_axis[1]), tree.joint_axis[1]]
    shapes = find_linked_shapes(links, axes, flying=flying)
    return shapes, tuple(contacts_alone(links, shapes))


def _filled(
    tree: ObjectModel, shapes: Sequence[ConvexShape], fall: FreeFall, settings: UnknownObjectSettings
) -> ObjectModel:
    """The object as flight and evenly filled shapes have it; of links, mass goes by volume."""
    volume, middle, inertia = (np.array(part) for part in zip(*(shape.solid() for shape in shapes), strict=True))
    mass, free = settings.mass * volume / volume.sum(), determined(tree)
    parts = moments_of_com(tree, middle, mass)
    parts += ((fall.com - parts).ravel() @ free @ free.T).reshape(-1, 3)
    return tree.with_changes(
        name=settings.name,
        mass=mass,
        com=com_of_moments(tree, parts, mass),
        inertia=mass[:, None, None] * inertia,
        corner_body=np.repeat(np.arange(len(shapes)), [len(shape.corners) for shape in shapes]),
        corner_pos=np.concatenate([shape.corners for shape in shapes]),
        roundness=shapes[0].roundness,
        friction=settings.friction,
        width=shapes[0].mean_width,
    )


def _is_sure(shape: ConvexShape, *, linked: bool) -> bool:
    """Whether corners stay: those of a link that no contact shows cannot be learned either."""
    agrees = abs(shape.ground[0]) < DISAGREEMENT
    shown = shape.deviation[shape.frames > 0] if linked else shape.deviation
    return shape.roundness is not None or bool(shown.max() < SURE and agrees)


def _link_json(shape: ConvexShape, alone: NDArray[np.int64]) -> dict[str, Any]:
    return {
        "shape": shape.kind,
        "corners_m": shape.vertices.round(6).tolist(),
        "corner_deviation_m": [None if np.isinf(sd) else round(float(sd), 6) for sd in shape.deviation],
        "contacts": shape.frames.tolist(),
        "contacts_alone": alone.tolist(),
        "unseen_m": shape.unseen.round(6).tolist(),
        "misfit_m": shape.misfit,
    }


def _off_ground(tosses: Sequence[Toss], tree: ObjectModel, shapes: Sequence[ConvexShape]) -> dict[str, float]:
    """Height of the shape at the end of each toss that comes to rest well above or below the ground [m].

    Of a body frame that jumps between tosses, the half-spaces hold what both positions of the object share. So some of
    its faces hover at rest.

    Raises:
        InputError: Too many do.
    """
    height = {toss.name: float(_clearance(toss, tree, shapes)[-1]) for toss in tosses if toss.phase[-1] == Phase.REST}
    off = {name: z for name, z in height.items() if abs(z) > REST_OFF_REL * shapes[0].mean_width}
    if len(off) > max(1, MOST_REST_OFF * len(height)):
        worst = 1e3 * max(map(abs, off.values()))
        raise InputError(
            f"no one shape rests on the ground: {len(off)} of {len(height)} tosses end up to {worst:.0f} mm above or "
            f"below it ({', '.join([*off][:3])}, …). Either the body's frame jumps between tosses, or they rest on "
            "something else than the ground z = 0"
        )
    return off


def _clearance(toss: Toss, tree: ObjectModel, shapes: Sequence[ConvexShape]) -> np.ndarray:
    """Height of the lowest point of all links in each frame [m], (n,)."""
    each = [half_spaces(link) for link in body_tracks(tree, [toss])]
    gaps = [spaces.height - shape.reach(spaces.down) for spaces, shape in zip(each, shapes, strict=True)]
    return np.asarray(np.min(gaps, axis=0))
