"""Edits of an MJCF model's contact: friction, a contact that bounces or yields, and a rigid one."""

from __future__ import annotations

import numpy as np

from tossid.physics.effects.mjcf_edit import (
    Edit,
    body_of,
    contact_pair,
    contacts,
    named,
    refine_step,
    round_cone,
)
from tossid.physics.effects.mujoco_contact import SOFT_IMPEDANCE, bouncing_solref, soft_contact
from tossid.physics.effects.world import World
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP
from tossid.rotations import skew

STEPS_PER_SWING = 20.0
"""MuJoCo steps within 1 / omega of a contact's spring: the motion is then that of the spring within a few percent."""


def write_friction(edit: Edit, before: World, after: World) -> None:
    """Set sliding, torsional and rolling friction.

    MuJoCo takes the larger of two geoms' coefficients, so both get them.

    Args:
        edit: The model.
        before: The world without the effect.
        after: The world with it.
    """
    law = after.law
    condim = 6 if law.rolling > 0 else 4 if law.torsional > 0 else 3
    for geom in (*edit.grounds, *edit.own):
        where, now = named("geom", geom), np.array(geom.friction)
        values = [after.object.friction, law.torsional if condim > 3 else now[1], law.rolling if condim > 4 else now[2]]
        edit.set(geom, "friction", values, where)
        if geom.condim < condim:
            edit.set(geom, "condim", condim, where)
    for pair in edit.spec.pairs:
        now, mu = np.array(pair.friction), after.object.friction
        turning = [law.torsional if condim > 3 else now[2], *([law.rolling if condim > 4 else now[3]] * 2)]
        edit.set(pair, "friction", [mu * law.y_rel, mu, *turning], named("contact pair", pair))
        edit.set(pair, "condim", max(int(pair.condim), condim), named("contact pair", pair))


def write_compliance(edit: Edit, before: World, after: World) -> None:
    """Give each corner a spring and a damper, by an impedance and its solref (`mujoco_contact`).

    Args:
        edit: The model.
        before: The world without the effect.
        after: The world with it.
    """
    pair = contact_pair(edit, before)
    if pair is None:
        return
    m = edit.compiled()
    stiffness = 1 / after.object.compliance
    soft = soft_contact(after, float(m.body_invweight0[body_of(m), 0]))
    where, note = "contact pair", "stiffness and damping of a corner"
    if soft.impedance == SOFT_IMPEDANCE:
        note += ", but for an added mass of 0.2 %"
    edit.set(pair, "solref", soft.solref, where, note=note)
    edit.set(pair, "solimp", soft.solimp, where)
    swing = float(np.sqrt(stiffness / (_corner_mass(after) + after.law.added_mass)))
    refine_step(edit, 1 / (STEPS_PER_SWING * swing))
    if after.law.added_mass == 0:
        edit.set(pair, "solreffriction", soft.solreffriction(edit.spec.option.timestep), where)
    round_cone(edit)
    edit.set(edit.spec.option, "impratio", soft.impratio, "option", note="friction does not creep")


def write_restitution(edit: Edit, before: World, after: World) -> None:
    """Give contact a spring and a damper that bounce without pulling (`mujoco_contact`).

    Args:
        edit: The model.
        before: The world without the effect.
        after: The world with it.
    """
    refine_step(edit, 2 * RIGID_STEP)
    solref = list(bouncing_solref(max(after.object.restitution, 1e-3), edit.spec.option.timestep))
    note = "exact for a corner that lands alone; several at once leave with another speed"
    for where, element in contacts(edit):
        edit.set(element, "solref", solref, where, exact=False, note=note)
        edit.set(element, "solimp", RIGID_SOLIMP, where, exact=False)


def write_rigid_contact(edit: Edit) -> None:
    """Make contact as rigid as `mujoco_engine` has it, with Coulomb's cone.

    Args:
        edit: The model.
    """
    refine_step(edit, 2 * RIGID_STEP)
    solref = [2 * edit.spec.option.timestep, RIGID_DAMPING]
    for where, element in contacts(edit):
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
