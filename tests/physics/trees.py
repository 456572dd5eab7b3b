"""Random kinematic trees, as MJCF, for comparison with MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from tossid.objects import JointLaw, ObjectModel, object_from_mjcf
from tossid.physics.effects import Forces

EVERYTHING = Forces(0.1, 0.1, 0.002, 2.0, -1.0, 0.03, 0.3, -0.2, 0.5, 4.0, 0.3, 0.2, 1.0, 2.0, 1.5)
"""All forces of the state at once."""


def random_tree(rng: np.random.Generator, *, n_bodies: int, slides: bool = True) -> ObjectModel:
    """A free base with hinges (and slides) in random places, random inertia, random off-centre masses."""
    spec = mujoco.MjSpec()
    spec.modelname = "tree"
    bodies: list[mujoco.MjsBody] = []
    for b in range(n_bodies):
        up = spec.worldbody if b == 0 else bodies[rng.integers(len(bodies))]
        quat = rng.normal(size=4)
        body = up.add_body(name=f"link_{b}", pos=rng.normal(size=3) * 0.1, quat=quat / np.linalg.norm(quat))
        axes = rng.normal(size=(3, 3)) * 0.05
        # moments of a random cloud of points: always physical
        cloud = axes @ axes.T + 1e-4 * np.eye(3)
        inertia = np.trace(cloud) * np.eye(3) - cloud
        body.explicitinertial = True
        body.mass = float(rng.uniform(0.1, 1.0))
        body.ipos = rng.normal(size=3) * 0.03
        I = body.mass * inertia
        body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        if b == 0:
            body.add_freejoint()
        else:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if slides and rng.uniform() < 0.3 else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(name=f"joint_{b}", type=kind, pos=rng.normal(size=3) * 0.05, axis=rng.normal(size=3))
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=rng.uniform(0.02, 0.06, size=3), pos=rng.normal(size=3) * 0.02
        )
        bodies.append(body)
    spec.compile()
    return object_from_mjcf(spec.to_xml())


def random_state(rng: np.random.Generator, model: ObjectModel) -> tuple[np.ndarray, np.ndarray]:
    """A configuration and a velocity of a vigorous toss."""
    q = rng.normal(size=model.nq)
    q[3:7] /= np.linalg.norm(q[3:7])
    return q, rng.normal(size=model.nv) * 3.0


def jointed(model: ObjectModel, **law: float) -> ObjectModel:
    there = np.arange(model.n_bodies) > 0
    return model.with_changes(joint_law=JointLaw(*(law.get(name, 0.0) * there for name in JointLaw._fields)))


def flying(model: ObjectModel, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """States high above the ground."""
    rng = np.random.default_rng(3)
    q, v = map(np.array, zip(*(random_state(rng, model) for _ in range(count)), strict=True))
    q[:, 2] += 20.0
    return q, v
