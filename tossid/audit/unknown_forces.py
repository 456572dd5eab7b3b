"""Forces that the library of effects does not have, for cases in which a diagnosis must name nothing."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.physics.effects.strength import Strength, Values, between, directed, plain

Array = NDArray[np.float64]
Push = Callable[[float, Array, Array], Array]
"""From time [s], q (B, nq), v (B, nv) to the force (B, 3) [N], of which each link has its share by mass."""

_SWITCH_STEP = 1e-3
"""Time step in which the telegraph force may change its sign [s]."""

UNKNOWN_FORCES: dict[str, Strength] = {
    "cubic_drag": Strength(5e-3, 0.8, plain("c_ns3pm3")),
    "pulsing_force": Strength(
        0.03, 5.0, lambda s, u: {**directed("x_n", "y_n")(s, u), "period_s": between(0.08, 0.25, u[2])}
    ),
    "telegraph_force": Strength(
        0.03, 5.0, lambda s, u: {**directed("x_n", "y_n")(s, u), "switches_ps": between(8, 30, u[2])}
    ),
}
"""A drag -c |u|² u; a force to and fro, from a phase that is drawn for each toss; a force that changes its sign at
random times."""


def push_of(name: str, values: Values, *, count: int, seconds: float, seed: int) -> Push:
    """A force that the library does not have.

    Args:
        name: One of `UNKNOWN_FORCES`.
        values: Its parameters.
        count: How many tosses it acts on.
        seconds: Their length at most [s].
        seed: Seed of what is drawn for each toss.

    Returns:
        The force as a function of time and state.

    Raises:
        InputError: There is no such force.
    """
    rng = np.random.default_rng(seed)
    if name == "cubic_drag":
        return lambda t, q, v: -values["c_ns3pm3"] * (v[:, :3] ** 2).sum(1, keepdims=True) * v[:, :3]
    force = np.array([values["x_n"], values["y_n"], 0.0])
    if name == "pulsing_force":
        phase = rng.uniform(0, 2 * np.pi, count)
        return lambda t, q, v: np.sin(2 * np.pi * t / values["period_s"] + phase)[:, None] * force
    if name == "telegraph_force":
        n = math.ceil(seconds / _SWITCH_STEP) + 2
        flips = rng.uniform(size=(count, n)) < values["switches_ps"] * _SWITCH_STEP
        signs = np.where((flips.cumsum(1) + rng.integers(0, 2, (count, 1))) % 2, 1.0, -1.0)
        return lambda t, q, v: signs[:, min(int(t / _SWITCH_STEP), n - 1), None] * force
    raise InputError(f"there is no force '{name}' in the audit")
