"""Which combinations of a tree's inertial parameters its motion depends on.

M(q) and the bias are linear in each body's mass m, first moment (mx, my, mz) and inertia about its origin (xx, yy, zz,
xy, xz, yz). Some of these never enter by themselves: mass on a hinge's axis moves the same on either side of it. The
base parameters of Gautier and Khalil ("Direct calculation of minimum set of inertial parameters of serial robots", T-RO
1990) are the independent ones, each with what of the dependent ones goes along; found here as in Gautier ("Numerical
calculation of the base inertial parameters of robots", 1991), from the kinetic energy in random states.

Tosses over fixed ground see them up to a common factor, so they are given over the total mass, which is one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.physics.batch import mass_matrices, tree_batch
from tossid.physics.system import make_system

Array = NDArray[np.float64]

NAMES = ("m", "mx", "my", "mz", "xx", "yy", "zz", "xy", "xz", "yz")
STATES = 40
"""Random states for each parameter."""
SMALL = 1e-7
"""Share of a parameter's own effect below which it counts as depending on others."""
PREFERRED = 0.3
"""The first parameter is chosen whose share is not much below the largest. So no combination has large factors, of a
hinge that lies nearly along a body's axis, or off its origin, either."""


@dataclass(frozen=True)
class BaseParameters:
    """Combinations of the inertial parameters (10 n_b) that motion depends on.

    names (P,): in words. rows (P, 10 n_b): the combinations. In SI units, with lengths in metres.
    """

    names: tuple[str, ...]
    rows: Array

    def values(self, model: ObjectModel) -> Array:
        """(P,) of an object, over its total mass: [1], [m] and [m²]."""
        out: Array = self.rows @ inertial_parameters(model) / model.mass.sum()
        return out

    def errors(self, model: ObjectModel, truth: ObjectModel) -> Array:
        """(P,) of an object, over the largest true value of their kind: first moments, and moments of inertia."""
        here, there = self.values(model), self.values(truth)
        kinds = np.array([order(name) for name in self.names])
        sizes = np.array([np.abs(there[kinds == kind]).max(initial=0.0) for kind in kinds])
        return np.where(sizes > 0, np.abs(here - there) / np.where(sizes > 0, sizes, 1.0), np.abs(here - there))


def order(name: str) -> int:
    """Whether a combination is a mass (0), a first moment (1) or an inertia (2)."""
    symbol = name.split(" ", 1)[0].rsplit(".", 1)[1]
    return 0 if symbol == "m" else 1 if symbol.startswith("m") else 2


def inertial_parameters(model: ObjectModel) -> Array:
    """(10 n_b,) in the order of `NAMES`, body by body; inertia about the bodies' origins."""
    out = []
    for b in range(model.n_bodies):
        m, c = model.mass[b], model.com[b]
        I = model.inertia[b] + m * (c @ c * np.eye(3) - np.outer(c, c))
        out += [m, *(m * c), I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    return np.array(out)


def base_parameters(model: ObjectModel) -> BaseParameters:
    """The combinations for the object's tree; its own inertia does not enter."""
    W = _energies(model)
    scale = np.linalg.norm(W, axis=0)
    W = W / scale  # each parameter by its own effect
    chosen: list[int] = []
    left = W.copy()  # of each column, what the chosen ones do not have
    while (size := np.linalg.norm(left, axis=0)).max() > SMALL:
        j = int(np.argmax(size > PREFERRED * size.max()))
        chosen.append(j)
        unit = left[:, j] / size[j]
        left -= np.outer(unit, unit @ left)
        left[:, chosen] = 0.0
    chosen.sort()
    dependent = [j for j in range(W.shape[1]) if j not in chosen]
    shares = np.linalg.lstsq(W[:, chosen], W[:, dependent], rcond=None)[0] if dependent else np.zeros((len(chosen), 0))
    rows = np.zeros((len(chosen), W.shape[1]))
    rows[np.arange(len(chosen)), chosen] = 1.0
    rows[:, dependent] = shares * scale[dependent] / scale[chosen][:, None]
    rows[np.abs(rows) < 1e-9] = 0.0
    words = [f"{model.body_names[j // 10]}.{NAMES[j % 10]}" for j in range(W.shape[1])]
    names = []
    for row, first in zip(rows, chosen, strict=True):
        rest = [(row[j], words[j]) for j in np.flatnonzero(row) if j != first]
        names.append(" ".join([words[first], *(f"{'+' if x > 0 else '-'} {abs(x):.4g} {word}" for x, word in rest)]))
    return BaseParameters(tuple(names), rows)


def inertia_about_com(model: ObjectModel) -> Array:
    """The mass matrix of spin and joint rates about the common centre of mass, (n, 3 + n_j, 3 + n_j) [kg m²].

    At random joint positions, the same for all objects. Of one rigid body it is its inertia.
    """
    n = STATES * model.n_joints if model.n_joints else 1
    q = np.zeros((n, model.nq))
    q[:, 3], q[:, 7:] = 1.0, np.random.default_rng(0).uniform(-np.pi, np.pi, (n, model.n_joints))
    system = make_system(model)
    M = mass_matrices(tree_batch(system, q, np.zeros((n, model.nv))), system)
    across = M[:, :3, 3:]
    return np.asarray(M[:, 3:, 3:] - across.swapaxes(-1, -2) @ np.linalg.solve(M[:, :3, :3], across))


def inertia_error(model: ObjectModel, truth: ObjectModel) -> float:
    """Largest relative error of the kinetic energy about the common centre of mass, over motions and joint positions.

    Args:
        model: An object.
        truth: The same tree, in the same frames, of the same mass.
    """
    ratios = np.linalg.eigvals(np.linalg.solve(inertia_about_com(truth), inertia_about_com(model)))
    return float(np.abs(ratios - 1).max())


def _energies(model: ObjectModel) -> Array:
    """Kinetic energy of random states (N, 10 n_b), for a unit of each parameter."""
    rng = np.random.default_rng(0)
    n = STATES * 10 * model.n_bodies
    q = np.concatenate([np.zeros((n, 3)), rng.normal(size=(n, 4)), rng.uniform(-3, 3, (n, model.n_joints))], axis=1)
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    v = rng.normal(size=(n, model.nv)) * np.r_[np.full(3, model.width), np.ones(model.nv - 3)]
    batch = tree_batch(make_system(model), q, v)
    twist = np.einsum("nbij,nj->nbi", batch.X, v)
    w, u = twist[..., :3], twist[..., 3:]
    x = np.cross(u, w)  # u . (w x c) = c . (u x w)
    parts = [
        0.5 * (u * u).sum(-1),
        *np.moveaxis(x, -1, 0),
        *(0.5 * np.moveaxis(w, -1, 0) ** 2),
        *(w[..., i] * w[..., j] for i, j in ((0, 1), (0, 2), (1, 2))),
    ]
    return np.stack(parts, axis=-1).reshape(n, -1)
