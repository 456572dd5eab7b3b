"""A single body as the kernel of `body` reads it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.physics.forces import Forces, Law, forces_of, law_of
from tossid.physics.system import System

Array = NDArray[np.float64]


class Body(NamedTuple):
    """What the kernel reads of a single body, as plain arrays.

    mass [kg]; com (3,); inertia (3, 3) about it; inverse (3, 3) = root root^T; root (3, 3) lower triangular;
    corner (3, n_c) from the origin; arm (n_c, 3) from the centre of mass; mu (n_c,); gravity (3,). Of rounded corners
    both are to their spheres' centres.
    restitution, compliance, relaxation and cohesion as in `System`. forced, lawful: whether `forces` and `law` act.
    """

    mass: float
    com: Array
    inertia: Array
    inverse: Array
    root: Array
    corner: Array
    arm: Array
    mu: Array
    restitution: float
    compliance: float
    relaxation: float
    cohesion: float
    gravity: Array
    forced: bool
    forces: Forces
    lawful: bool
    law: Law


def make_body(system: System) -> Body | None:
    """The body of a system that is one physical body; None for a tree, or a mass matrix that is not positive."""
    if system.nv != 6:
        return None
    mass, inertia = float(system.mass[0]), np.ascontiguousarray(system.inertia[0])
    try:
        np.linalg.cholesky(inertia)
        inverse = np.linalg.inv(inertia)
        root = np.linalg.cholesky(0.5 * (inverse + inverse.T))
    except np.linalg.LinAlgError:
        return None
    if not (mass > 0.0 and np.isfinite(root).all()):
        return None
    com = np.ascontiguousarray(system.com[0])
    forces, law = forces_of(system.forces), law_of(system.law)
    corner = inset(system.corner_pos, law.rounding)
    return Body(
        mass=mass,
        com=com,
        inertia=inertia,
        inverse=inverse,
        root=np.ascontiguousarray(root),
        corner=np.ascontiguousarray(corner.T),
        arm=np.ascontiguousarray(corner - com),
        mu=np.ascontiguousarray(system.mu),
        restitution=float(system.restitution),
        compliance=float(system.compliance),
        relaxation=float(system.relaxation),
        cohesion=float(system.cohesion),
        gravity=np.ascontiguousarray(system.gravity),
        forced=forces.acts,
        forces=forces,
        lawful=law.acts,
        law=law,
    )


def inset(corner_pos: Array, radius: float) -> Array:
    """Centres (n_c, 3) of spheres in the corners (n_c, 3) of a box along the axes, that touch its faces [m]."""
    middle = 0.5 * (corner_pos.min(axis=0) + corner_pos.max(axis=0))
    out: Array = corner_pos - radius * np.sign(corner_pos - middle)
    return out
