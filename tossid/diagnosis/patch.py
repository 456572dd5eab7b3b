"""The patch: what a diagnosis found, as changed MJCF and as changed keys of the object.

MuJoCo has a word for most effects (`patch_edits`), and an exact one for some. Where its word is another law than
ours the change says so, and the rerun (`patch_rerun`) shows what it is worth. What MJCF cannot say is listed with
the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tossid.diagnosis.edit import Change, Edit
from tossid.diagnosis.evidence import Hypothesis
from tossid.diagnosis.patch_edits import EDITS, OF_LINKS, REASONS, RECORDED, compliance, rigid_contact
from tossid.errors import ObjectError
from tossid.objects import to_mjcf
from tossid.physics.effects import World
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP


@dataclass(frozen=True)
class Patch:
    """Changes of a simulator.

    mjcf: the changed model's text. before, after: both models as MuJoCo compiled them.
    keys: changed numbers of tossid's own object and simulator, {key: {"before", "after"}}. recording: corrections of
    the recorded data in place of the simulator, {effect: text}. not_expressed: {effect: why MJCF has no word for it}.
    """

    mjcf: str
    before: mujoco.MjModel
    after: mujoco.MjModel
    changes: tuple[Change, ...]
    keys: dict[str, dict[str, Any]]
    recording: dict[str, str]
    not_expressed: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """gap.json's "patch" but for the rerun."""
        return {
            "keys": self.keys,
            "changes": [change.as_json() for change in self.changes],
            "recording": self.recording,
            "not_expressed": self.not_expressed,
            "mjcf": self.mjcf if self.changes else None,
        }


def make_patch(hypothesis: Hypothesis, *, mjcf: Path | None = None, rigid: bool = False) -> Patch:
    """What turns the hypothesis's base world into the world with its effects.

    Args:
        mjcf: the file of the user's own MuJoCo model; a near rigid scene of the base world if None.
        rigid: its contact is made rigid first, as the hypothesis has it and the model does not.

    Raises:
        ObjectError: MuJoCo cannot compile the model.
    """
    spec = read_spec(mjcf or _rigid_scene(hypothesis.base))
    edit = Edit(spec)
    before = hypothesis.base
    if mjcf is None and before.object.compliance > 0:  # what the base already has and rigid MJCF lacks
        compliance(edit, before, before)
        edit.changes.clear()
    compiled = edit.compiled()
    if before.residual is not None:
        edit.cannot["residual"] = "a learned residual acceleration has no counterpart in MJCF"
    if rigid:
        edit.effect = "rigid contact"
        rigid_contact(edit)
    world = before
    for effect, values in zip(hypothesis.effects, hypothesis.values, strict=True):
        after = effect.at(world, values)
        edit.effect = effect.name
        if effect.name in RECORDED:
            edit.recording[effect.name] = RECORDED[effect.name](after)
        elif after.object.n_joints and effect.name in OF_LINKS:
            edit.cannot[effect.name] = OF_LINKS[effect.name]
        elif effect.name in EDITS:
            EDITS[effect.name](edit, world, after)
        else:
            edit.cannot[effect.name] = REASONS.get(effect.name, "MJCF has no word for it")
        world = after
    patched = edit.compiled()
    if mjcf is not None:  # the text is for another place than the file's
        spec.meshdir = str(mjcf.resolve().parent / spec.meshdir)
    keys = _keys(before, world)
    return Patch(spec.to_xml(), compiled, patched, tuple(edit.changes), keys, edit.recording, edit.cannot)


def _rigid_scene(world: World) -> str:
    """The world in MuJoCo, with contact as rigid as `mujoco_engine` states it, at twice its time step."""
    step = 2 * RIGID_STEP
    solref = (2 * step, RIGID_DAMPING)
    return to_mjcf(world.object, gravity=world.gravity, timestep=step, solref=solref, solimp=RIGID_SOLIMP)


def read_spec(source: str | Path) -> mujoco.MjSpec:
    """A MuJoCo model, from a file or from text.

    Raises:
        ObjectError: MuJoCo cannot read it.
    """
    try:
        if isinstance(source, Path):
            return mujoco.MjSpec.from_file(str(source))
        return mujoco.MjSpec.from_string(source)
    except (ValueError, mujoco.FatalError) as error:
        raise ObjectError(f"MuJoCo cannot read the model: {str(error).splitlines()[0]}") from error


def _keys(before: World, after: World) -> dict[str, dict[str, Any]]:
    """Numbers of the object and of the simulator that differ."""
    pairs: dict[str, tuple[Any, Any]] = {}
    for name in ("friction", "restitution", "compliance", "relaxation", "cohesion", "mass", "com", "inertia"):
        pairs[f"object.{name}"] = (getattr(before.object, name), getattr(after.object, name))
    for name, was in before.object.joints._asdict().items():
        pairs[f"object.joints.{name}"] = (was, getattr(after.object.joints, name))
    pairs["object.corner_pos"] = (before.object.corner_pos, after.object.corner_pos)
    pairs["gravity"] = (before.gravity, after.gravity)
    pairs["ground_height"] = (before.ground_height, after.ground_height)
    pairs["ground_tilt"] = (before.ground_tilt, after.ground_tilt)
    for part in ("forces", "law"):
        one, other = getattr(before, part), getattr(after, part)
        pairs |= {f"{part}.{name}": (getattr(one, name), getattr(other, name)) for name in one._fields}
    for name in vars(before.recording):
        pairs[f"recording.{name}"] = (getattr(before.recording, name), getattr(after.recording, name))
    return {
        name: {"before": np.asarray(was).tolist(), "after": np.asarray(now).tolist()}
        for name, (was, now) in pairs.items()
        if not np.array_equal(was, now)
    }
