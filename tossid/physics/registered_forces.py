"""Forces that a user adds to the compiled time step: the class of a force's parameters chooses the function.

A world without registered forces has the type `NoForce`, whose force is zero when a kernel is compiled (docs/adr/0014).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.kernels import by_type, implemented, implements, kernel, register_implementation

Array = NDArray[np.float64]

ARGUMENTS = ("force", "position", "velocity", "spin")
"""What a registered function takes, in this order."""

RegisteredForce = Any
"""A NamedTuple of a force's parameters, of a class that is registered."""


class NoForce(NamedTuple):
    """The parameters of no registered force."""


class Both(NamedTuple):
    """Two forces that act together.

    Attributes:
        first: One force.
        second: The other. Either may be `Both` again.
    """

    first: Any
    second: Any


@by_type
def wrench_of(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    """Force [N] and torque [N m], two tuples of three, world axes, as `register_force` explains them."""


def register_force(kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that makes a function the force of a NamedTuple class of parameters.

    `World.with_force` then adds the force to a world. The first simulation of each process compiles the time stepper
    anew for it. Other values of the parameters need no compiling.

    Args:
        kind: a NamedTuple class with the force's parameters as fields (floats).

    Returns:
        A decorator of `function(force, position, velocity, spin) -> (force, torque)`, which Numba can compile. It is
        given the parameters, the position [m] and velocity [m/s] of the centre of mass, and the spin [rad/s]. It
        returns a force on the centre of mass [N] and a torque about it [N m]. All vectors are tuples of three in the
        ground's frame: world axes, unless the ground is tilted. The force is taken at the middle of a step, the torque
        at its start. Of an object with joints, each link feels its share by mass of what a single body of the whole
        mass would feel with the link's position, velocity and spin.

    Raises:
        InputError: the class is no NamedTuple class or has a force already, or the function takes other arguments.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        register_implementation(wrench_of, kind, function, ARGUMENTS, "force")
        compiled = function if hasattr(function, "py_func") else kernel(function, keep=False)

        @implements(wrench_of, kind)
        def wrench(force, position, velocity, spin):  # type: ignore[no-untyped-def]
            return compiled(force, position, velocity, spin)

        return compiled

    return register


def acts(force: RegisteredForce) -> bool:
    """Whether there is a registered force.

    Args:
        force: as `combined` returns it.
    """
    return not isinstance(force, NoForce)


def combined(forces: Sequence[RegisteredForce]) -> RegisteredForce:
    """Several forces as one.

    Args:
        forces: of registered classes; none for `NoForce`.

    Raises:
        InputError: one is of a class that is not registered.
    """
    for force in forces:
        if type(force) not in implemented(wrench_of):
            raise InputError(f"{force!r} is no registered force; see register_force")
    return reduce(Both, forces) if forces else NoForce()


def wrenches_of(force: RegisteredForce, position: Array, velocity: Array, spin: Array) -> tuple[Array, Array]:
    """Force and torque in several states.

    Args:
        force: as `combined` returns it.
        position: (B, 3) of the centre of mass [m], ground's frame, as all that follows.
        velocity: (B, 3) of the centre of mass [m/s].
        spin: (B, 3) [rad/s].

    Returns:
        Force (B, 3) [N] and torque (B, 3) [N m].
    """
    out = np.empty((2, *position.shape))
    _wrenches(force, position, velocity, spin, out)
    return out[0], out[1]


@kernel
def _wrenches(force, position, velocity, spin, out):  # type: ignore[no-untyped-def]
    p, u, w = position, velocity, spin
    for i in range(p.shape[0]):
        (out[0, i, 0], out[0, i, 1], out[0, i, 2]), (out[1, i, 0], out[1, i, 1], out[1, i, 2]) = wrench_of(
            force, (p[i, 0], p[i, 1], p[i, 2]), (u[i, 0], u[i, 1], u[i, 2]), (w[i, 0], w[i, 1], w[i, 2])
        )


@implements(wrench_of, NoForce)
def _none(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


@implements(wrench_of, Both)
def _sum(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    (f0, f1, f2), (t0, t1, t2) = wrench_of(force.first, position, velocity, spin)
    (g0, g1, g2), (u0, u1, u2) = wrench_of(force.second, position, velocity, spin)
    return (f0 + g0, f1 + g1, f2 + g2), (t0 + u0, t1 + u1, t2 + u2)
