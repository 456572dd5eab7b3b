"""Recorded tosses without an error of the recording that is not the same in all of them.

An effect of the measurement is a map from true to recorded motion and leaves the simulator as it is. So tosses can be
taken back through it one by one, and the corrected ones are diagnosed as a recording without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.result import Diagnosis
from tossid.diagnosis.sessions.heights import last_corner, moved
from tossid.physics.effects import Effect, World, all_effects
from tossid.physics.effects.effect import RecordingCorrection
from tossid.rotations import quat_conj, quat_mul, quat_to_matrix
from tossid.types import Toss

Array = NDArray[np.float64]

CORRECTABLE = ("world_tilt", "ground_height", "length_scale", "body_frame_offset", "joint_offset")
"""Effects that do no more than map true motion to recorded motion. The ground's height is one: to raise the ground is
to lower what is recorded over it. A clock's rate is none: corrected tosses would have frames of different lengths, and
windows have one."""


def corrected(toss: Toss, world: World, effect: Effect, values: Array) -> Toss:
    """A toss as it would have been recorded without an effect.

    Args:
        toss: As recorded.
        world: The simulator without the effect; its own recording errors stay.
        effect: One of `CORRECTABLE`.
        values: (P,) of the effect.
    """
    wrong = effect.at(world, values)

    def back(q: Array, v: Array) -> tuple[Array, Array]:
        return world.recorded(*wrong.to_ground(q, v))

    q, v = back(toss.q, toss.v)
    turn = quat_to_matrix(quat_mul(q[:1, 3:7], quat_conj(toss.q[:1, 3:7])))[0]
    scale = world.recording.length_scale / wrong.recording.length_scale
    measured, measured_cov = toss.q_measured, toss.q_measured_cov
    return replace(
        toss,
        q=q,
        v=v,
        q_cov=_carried(toss.q_cov, turn, scale),
        v_cov=_carried(toss.v_cov, turn, scale),
        q_measured=None if measured is None else back(measured, np.zeros((len(measured), toss.v.shape[1])))[0],
        q_measured_cov=None if measured_cov is None else _carried(measured_cov, turn, scale),
    )


def _carried(cov: Array, turn: Array, scale: float) -> Array:
    """Covariances (T, nv, nv) of motion that is turned and scaled; only positions are of the world."""
    carry = np.eye(cov.shape[-1])
    carry[:3, :3] = scale * turn
    return np.asarray(carry @ cov @ carry.T)


def corrected_tosses(
    tosses: Sequence[Toss], world: World, effect: Effect, values: Array, *, own_heights: bool = False
) -> tuple[Toss, ...]:
    """Tosses without an effect that has values of its own in each.

    Args:
        tosses: n, as recorded.
        world: The simulator without the effect.
        effect: One of `CORRECTABLE`.
        values: (n, P).
        own_heights: Whether their heights were set one by one, so that each is turned about its last lowest corner.
    """
    ends = [last_corner(toss, world.object) if own_heights else np.zeros(2) for toss in tosses]
    there = (moved(toss, -end) for toss, end in zip(tosses, ends, strict=True))
    right = (corrected(toss, world, effect, own) for toss, own in zip(there, values, strict=True))
    return tuple(moved(toss, end) for toss, end in zip(right, ends, strict=True))


def corrections(found: Diagnosis) -> dict[str, str]:
    """By effect that changes over the order of recording, how the recorded data are corrected, as a patch has it.

    Args:
        found: The diagnosis.
    """
    effects, base = {effect.name: effect for effect in all_effects()}, found.hypothesis.base
    out = {}
    for finding in found.findings:
        order, effect = finding.over_order, effects.get(finding.name)
        if order is not None and effect is not None and isinstance(effect.mjcf, RecordingCorrection):
            parts = []
            for stretch in order.stretches:
                values = np.array([stretch.parameters[p.name].value for p in effect.parameters])
                some = f"toss {stretch.first}" if order.form == "drift" else f"tosses {stretch.first} to {stretch.last}"
                parts.append(f"{some}: {effect.mjcf.text(effect.at(base, values))}")
            out[finding.name] = "; ".join(parts) + ("; between them along a line" if order.form == "drift" else "")
    return out
