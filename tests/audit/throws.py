"""Throws of a cube, for tests of motions."""

from __future__ import annotations

import numpy as np

from tossid.objects import load_object
from tossid.physics.effects import World

DT = 1 / 148
"""Time between frames [s]."""


def throws(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    q = np.zeros((n, 7))
    q[:, 2] = rng.uniform(0.15, 0.3, n)
    q[:, 3:] = rng.normal(size=(n, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, np.concatenate([0.5 * rng.normal(size=(n, 3)), 3 * rng.normal(size=(n, 3))], axis=1)


def cube_world() -> World:
    return World(load_object("cube"))
