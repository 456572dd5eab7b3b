"""Contact problems of a rigid body, ordinary and degenerate, for the tests of the solvers."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_positions

Array = NDArray[np.float64]
Problem = tuple[Array, Array, Array]

MASS, INERTIA, HALF, GRAVITY, STEP = 0.37, 0.00081, 0.0524, 9.81, 1 / 148 / 4
CORNERS = HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
BOTTOM = CORNERS[CORNERS[:, 2] < 0]
UP = np.array([0.0, 0.0, 1.0])

FAMILIES = (
    "rest",
    "slide",
    "flat",
    "edge",
    "point",
    "duplicate",
    "wedge",
    "vee",
    "mass ratio",
    "huge friction",
    "frictionless",
    "random",
)


def delassus(points: Array, normals: Array, mass: float, inertia: Array) -> tuple[Array, Array]:
    """J (3 n, 6) and A = J M^-1 J^T of a body at the origin, order [n.., t1 t2 ..]."""
    n = len(points)
    J = np.zeros((3 * n, 6))
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        normal = normal / np.linalg.norm(normal)
        t1 = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        t1 /= np.linalg.norm(t1)
        for row, axis in zip((i, n + 2 * i, n + 2 * i + 1), (normal, t1, np.cross(normal, t1)), strict=True):
            J[row, :3], J[row, 3:] = axis, np.cross(point, axis)
    A = J @ np.diag(np.r_[np.full(3, 1 / mass), 1 / inertia]) @ J.T
    return J, 0.5 * (A + A.T)


def draw(family: str, rng: np.random.Generator, *, mu: float | None = None) -> Problem:
    """One problem (A, b, mu): every second gap is exactly zero, velocities are those of tosses."""
    friction = float(rng.choice([0.0, 0.05, 0.18, 0.5, 1.0]) if mu is None else mu)
    v = rng.normal(size=6) * [1, 1, 1, 5, 5, 5]
    mass, inertia = MASS, np.full(3, INERTIA)
    points, normals = BOTTOM, np.tile(UP, (4, 1))
    if family == "rest":
        v = np.array([0, 0, -GRAVITY * STEP, 0, 0, 0])
    elif family == "slide":
        v = np.r_[rng.normal(size=2), -GRAVITY * STEP, 0, 0, rng.normal()]
    elif family == "edge":
        points, normals = BOTTOM[:2], normals[:2]
    elif family == "point":
        w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
        down = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        lowest = CORNERS[np.argmin(CORNERS @ down)]
        points, normals = lowest[None], down[None]
    elif family == "duplicate":
        points = np.repeat(BOTTOM[:2], 2, axis=0)
    elif family == "wedge":
        sides = [CORNERS[CORNERS[:, 0] < 0][:2], CORNERS[CORNERS[:, 0] > 0][:2]]
        points = np.vstack([BOTTOM, *sides])
        normals = np.vstack([normals, np.tile([1.0, 0, 0], (2, 1)), np.tile([-1.0, 0, 0], (2, 1))])
    elif family == "vee":
        k = int(rng.integers(2, 5))
        points, angle = CORNERS[rng.choice(8, k, replace=False)], rng.choice([-1, 1], k) * rng.uniform(0.2, 1.4, k)
        normals = np.stack([np.sin(angle), np.zeros(k), np.cos(angle)], axis=1)
    elif family == "mass ratio":
        mass, inertia = float(10 ** rng.uniform(-3, 3)), 10 ** rng.uniform(-6, 1, size=3)
    elif family == "huge friction":
        friction = float(rng.choice([2, 10, 100]))
    elif family == "frictionless":
        friction = 0.0
    elif family == "random":
        k = int(rng.integers(1, 9))
        points, normals = 0.05 * rng.normal(size=(k, 3)), rng.normal(size=(k, 3))
        normals[:, 2] = np.abs(normals[:, 2]) + 0.3
    n = len(points)
    J, A = delassus(points, normals, mass, inertia)
    b = J @ v
    b[:n] += np.where(rng.random(n) < 0.5, 0.0, rng.exponential(1e-4, size=n)) / STEP
    return A, b, np.full(n, friction)


@cache
def draw_many(count: int, seed: int, families: tuple[str, ...] = FAMILIES) -> dict[int, Problem]:
    """`count` problems of all families, stacked by their number of contacts: n -> (A, b, mu)."""
    rng = np.random.default_rng(seed)
    by_size: dict[int, list[Problem]] = {}
    for k in range(count):
        problem = draw(families[k % len(families)], rng)
        by_size.setdefault(len(problem[2]), []).append(problem)
    stacks = {}
    for n, problems in sorted(by_size.items()):
        A, b, mu = (np.stack(parts) for parts in zip(*problems, strict=True))
        stacks[n] = (A, b, mu)
    return stacks


def landing(model: ObjectModel, rng: np.random.Generator, count: int, *, tilt: float = 3.0) -> tuple[Array, Array]:
    """States q (count, 7), v (count, 6) whose lowest corner is a millimetre above the ground and comes down.

    tilt: spread of the quaternion's vector part; small for a body that lands flat.
    """
    q = np.zeros((count, 7))
    q[:, 3:] = np.concatenate([np.ones((count, 1)), tilt * rng.normal(size=(count, 3))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    q[:, 2] = 1e-3 - corner_positions(model, q)[..., 2].min(axis=1)
    return q, rng.normal(size=(count, 6)) * [1, 1, 0.3, 3, 3, 3] - [0, 0, 1.5, 0, 0, 0]
