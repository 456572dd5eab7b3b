"""Contact that bounces or yields, in MuJoCo's numbers.

restitution e: solref (-w², -2 z w), a spring and a damper in acceleration's units. Of their oscillation the contact
    keeps what is no pull, which makes e a function of z (Schwager and Poeschel, "Coefficient of restitution and linear
    dashpot model revisited", Granular Matter 2007). w is a share of the time step's rate: the softer, the deeper.
compliance k [N/m] and damping d [N s/m] of a corner: MuJoCo's force is (a_ref - a) / R with a_ref = -B v - K D r,
    so that (K, B) = R (k / D, d) makes it k r + d v, but for an added mass 1 / R at the corner. The impedance D
    keeps that to 0.2 % of the object's mass. Friction has a reference of its own, which knows no compliance. The law's
    added mass is just that 1 / R, and its damping acts on friction too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scipy.optimize import brentq

from tossid.physics.effects.world import World

SOFT_IMPEDANCE = 0.002
"""Impedance of a compliant contact: its added mass, over the object's."""
BOUNCE_RATE = 0.125
"""A bouncing contact's frequency w times the time step."""


class SoftContact(NamedTuple):
    """A contact that yields, in MuJoCo's numbers; friction is a hundred times as stiff as what would creep.

    Attributes:
        impedance: MuJoCo's impedance D of the normal direction.
        solref: Stiffness and damping of the normal direction.
        solimp: The impedance as MuJoCo takes it.
        impratio: Impedance of friction over that of the normal direction.
    """

    impedance: float
    solref: list[float]
    solimp: list[float]
    impratio: float

    def solreffriction(self, step: float) -> list[float]:
        """MuJoCo's reference of friction that stops in a few time steps, whatever the contact's damping.

        Args:
            step: MuJoCo's time step [s].
        """
        return [-1e-9, -0.5 * self.impedance / step]


def soft_contact(world: World, inverse: float) -> SoftContact:
    """MuJoCo's contact of a world whose corners yield.

    Args:
        world: The world; its object's compliance is not 0.
        inverse: MuJoCo's estimate of a corner's inverse mass [1/kg], from which it makes R = (1 - D) / D of it.
    """
    o, added = world.object, world.law.added_mass * inverse
    d = max(SOFT_IMPEDANCE, float(added / (1 + added)))
    spring = (1 - d) * inverse / o.compliance
    solref = [-spring, -max(o.relaxation * spring, 1e-9)]
    return SoftContact(d, solref, [d, d, 0.001, 0.5, 2.0], max(1.0, 100 * (1 - d) / d))


def bouncing_solref(restitution: float, step: float) -> tuple[float, float]:
    """MuJoCo's solref of a contact that bounces.

    Args:
        restitution: e, above 0.
        step: MuJoCo's time step [s].
    """
    ratio = damping_ratio(restitution)
    rate = min(BOUNCE_RATE, 0.5 / ratio) / step
    return -(rate**2), -2 * ratio * rate


def damping_ratio(restitution: float) -> float:
    """Damping ratio z of a contact that bounces with a coefficient of restitution, and does not pull.

    Args:
        restitution: e, 0 < e <= 1.
    """

    def excess(z: float) -> float:
        w = math.sqrt(abs(1 - z * z))
        angle = math.pi - math.atan2(2 * z * w, 1 - 2 * z * z) if z < 1 else 2 * math.log(z + w)
        return (math.exp(-z / w * angle) if w > 0 else math.exp(-2)) - restitution

    return float(brentq(excess, 1e-9, 1e4)) if excess(1e-9) > 0 else 1e-9
