"""Contact that bounces or yields, in MuJoCo's numbers, and the edits of an MJCF model that say so.

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

import mujoco
import numpy as np
from scipy.optimize import brentq

from tossid.physics.effects.mjcf_edit import Edit, body_of, named, refine_step, round_cone
from tossid.physics.effects.world import World
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP
from tossid.rotations import skew

SOFT_IMPEDANCE = 0.002
"""Impedance of a compliant contact: its added mass, over the object's."""
BOUNCE_RATE = 0.125
"""A bouncing contact's frequency w times the time step."""
STEPS_PER_SWING = 20.0
"""MuJoCo steps within 1 / omega of a contact's spring: the motion is then that of the spring within a few percent."""


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
        """MuJoCo's reference of friction that stops in a few time steps [s], whatever the contact's damping."""
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
    """MuJoCo's solref of a contact that bounces with a restitution above 0, at its time step [s]."""
    ratio = damping_ratio(restitution)
    rate = min(BOUNCE_RATE, 0.5 / ratio) / step
    return -(rate**2), -2 * ratio * rate


def damping_ratio(restitution: float) -> float:
    """Damping ratio z of a contact that bounces with a coefficient of restitution, 0 < e <= 1, and does not pull."""

    def excess(z: float) -> float:
        w = math.sqrt(abs(1 - z * z))
        angle = math.pi - math.atan2(2 * z * w, 1 - 2 * z * z) if z < 1 else 2 * math.log(z + w)
        return (math.exp(-z / w * angle) if w > 0 else math.exp(-2)) - restitution

    return float(brentq(excess, 1e-9, 1e4)) if excess(1e-9) > 0 else 1e-9


def contact_pair(edit: Edit, world: World) -> mujoco.MjsPair | None:
    """The explicit contact pair of object and ground, made where a world's model has none; None if it were several."""
    if len(edit.grounds) != 1 or len(edit.own) != 1:
        edit.cannot[edit.effect] = "needs one ground geom and one geom of the object"
        return None
    if edit.spec.pairs:
        return edit.spec.pairs[0]
    (ground,), (own,) = edit.grounds, edit.own
    ground.name, own.name = ground.name or "ground", own.name or "object"
    mu, law = world.object.friction, world.law
    pair = edit.spec.add_pair(
        name="contact",
        geomname1=ground.name,
        geomname2=own.name,
        friction=[mu, mu, max(law.torsional, own.friction[1]), *[max(law.rolling, own.friction[2])] * 2],
        solref=own.solref,
        solimp=own.solimp,
    )
    pair.condim = max(3, own.condim)
    where = f"contact pair '{ground.name}', '{own.name}'"
    edit.changed(where, "condim", "", int(pair.condim), note="a pair of its own")
    return pair


def write_friction(edit: Edit, before: World, after: World) -> None:
    """Set sliding, torsional and rolling friction of both geoms: MuJoCo takes the larger of their coefficients."""
    law, mu = after.law, after.object.friction
    condim = 6 if law.rolling > 0 else 4 if law.torsional > 0 else 3
    for geom in (*edit.grounds, *edit.own):
        where, now = named("geom", geom), np.array(geom.friction)
        values = [mu, law.torsional if condim > 3 else now[1], law.rolling if condim > 4 else now[2]]
        edit.set(geom, "friction", values, where)
        edit.set(geom, "condim", max(int(geom.condim), condim), where)
    for pair in edit.spec.pairs:
        where, now = named("contact pair", pair), np.array(pair.friction)
        turning = [law.torsional if condim > 3 else now[2], *([law.rolling if condim > 4 else now[3]] * 2)]
        edit.set(pair, "friction", [mu * law.y_rel, mu, *turning], where)
        edit.set(pair, "condim", max(int(pair.condim), condim), where)


def write_compliance(edit: Edit, before: World, after: World) -> None:
    """Give each corner a spring and a damper, by an impedance and its solref."""
    pair = contact_pair(edit, before)
    if pair is None:
        return
    m = edit.compiled()
    soft = soft_contact(after, float(m.body_invweight0[body_of(m), 0]))
    where, note = "contact pair", "stiffness and damping of a corner"
    if soft.impedance == SOFT_IMPEDANCE:
        note += ", but for an added mass of 0.2 %"
    edit.set(pair, "solref", soft.solref, where, note=note)
    edit.set(pair, "solimp", soft.solimp, where)
    swing = float(np.sqrt(1 / after.object.compliance / (_corner_mass(after) + after.law.added_mass)))
    refine_step(edit, 1 / (STEPS_PER_SWING * swing))
    if after.law.added_mass == 0:
        edit.set(pair, "solreffriction", soft.solreffriction(edit.spec.option.timestep), where)
    round_cone(edit)
    edit.set(edit.spec.option, "impratio", soft.impratio, "option", note="friction does not creep")


def write_restitution(edit: Edit, before: World, after: World) -> None:
    """Give contact a spring and a damper that bounce without pulling."""
    refine_step(edit, 2 * RIGID_STEP)
    solref = list(bouncing_solref(max(after.object.restitution, 1e-3), edit.spec.option.timestep))
    note = "exact for a corner that lands alone; several at once leave with another speed"
    for where, element in edit.contacts:
        edit.set(element, "solref", solref, where, exact=False, note=note)
        edit.set(element, "solimp", RIGID_SOLIMP, where, exact=False)


def write_rigid_contact(edit: Edit) -> None:
    """Make contact as rigid as `mujoco_engine` has it, with Coulomb's cone."""
    refine_step(edit, 2 * RIGID_STEP)
    solref = [2 * edit.spec.option.timestep, RIGID_DAMPING]
    for where, element in edit.contacts:
        edit.set(element, "solref", solref, where, note="as stiff as the time step bears")
        edit.set(element, "solimp", RIGID_SOLIMP, where)
    round_cone(edit)


def _corner_mass(world: World) -> float:
    """Mass [kg] behind a corner that lands alone, over all orientations: 1 / mean of J_n M^-1 J_n^T."""
    o = world.object
    arm = o.corner_pos[o.corner_body == 0] - o.com[0]
    inverse = np.linalg.inv(o.inertia[0])
    turned = [np.trace(skew(r).T @ inverse @ skew(r)) / 3 for r in arm]
    return float(1 / (1 / o.mass[0] + np.mean(turned)))
