"""The patch: what a diagnosis found, as changed MJCF and as changed keys of the object.

MJCF can express most effects, and some of them exactly. Where MuJoCo's law differs from the effect's own, the change
says so, and the rerun in MuJoCo shows what it is worth. Effects that MJCF cannot express are listed with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.errors import ObjectError
from tossid.objects import to_mjcf
from tossid.objects.files.model_file import first_line, read_model_file
from tossid.physics.effects import World
from tossid.physics.effects.contact_in_mjcf import write_compliance, write_rigid_contact
from tossid.physics.effects.mjcf_edit import Change, Edit
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP
from tossid.settings.diagnosis.patch import PatchSettings


@dataclass(frozen=True)
class Patch:
    """Changes of a simulator.

    Attributes:
        mjcf: Text of the changed model.
        before: The model as it was, compiled by MuJoCo.
        after: The changed model, compiled by MuJoCo.
        changes: The changed attributes.
        keys: Changed numbers of tossid's own object and simulator: `before` and `after` by key.
        recording: By effect, how the recorded data are corrected where the recording is wrong, not the simulator.
        not_expressed: By effect, why MJCF cannot express it.
    """

    mjcf: str
    before: mujoco.MjModel
    after: mujoco.MjModel
    changes: tuple[Change, ...]
    keys: dict[str, dict[str, Any]]
    recording: dict[str, str]
    not_expressed: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """The content of gap.json's `patch`, without the rerun.

        Returns:
            Plain values.
        """
        return {
            "keys": self.keys,
            "changes": [change.as_json() for change in self.changes],
            "recording": self.recording,
            "not_expressed": self.not_expressed,
            "mjcf": self.mjcf if self.changes else None,
        }


def make_patch(
    hypothesis: Hypothesis,
    *,
    mjcf: Path | None = None,
    rigid: bool = False,
    settings: PatchSettings = PatchSettings(),
) -> Patch:
    """The changes from the base world of a hypothesis to the world with its effects.

    Args:
        hypothesis: The world and its effects.
        mjcf: File of the user's own MuJoCo model; a scene of the base world with nearly rigid contact if None.
        rigid: Whether the model's contact is made rigid first, because the hypothesis has rigid contact.
        settings: How effects are written.

    Returns:
        The patch.

    Raises:
        ObjectError: MuJoCo cannot compile the model.
    """
    spec = read_spec(mjcf or _rigid_scene(hypothesis.base))
    edit = Edit(spec, settings=settings)
    before = hypothesis.base
    if mjcf is None and before.object.compliance > 0:  # what the base already has and rigid MJCF lacks
        write_compliance(edit, before, before)
        edit.changes.clear()
    compiled = edit.compiled()
    if before.k_res is not None:
        edit.cannot["residual"] = "MJCF has no learned acceleration"
    if rigid:
        edit.effect = "rigid contact"
        write_rigid_contact(edit)
    world = before
    for effect, values in hypothesis.items():
        after = effect.at(world, values)
        edit.effect = effect.name
        effect.mjcf.write(edit, world, after)
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
    """A MuJoCo model that can be edited.

    Args:
        source: Its file, or its text.

    Returns:
        The model.

    Raises:
        FileError: The file is missing, or MuJoCo cannot read it or crashes while it compiles it.
        ObjectError: MuJoCo cannot read the text.
    """
    if isinstance(source, Path):
        return read_model_file(source).spec
    try:
        return mujoco.MjSpec.from_string(source)
    except (ValueError, mujoco.FatalError) as error:
        raise ObjectError(f"MuJoCo cannot read the model: {first_line(error)}") from error


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
    was_there = {type(force): force for force in before.registered}
    for force in after.registered:
        for name, now in force._asdict().items():
            was = getattr(was_there.get(type(force)), name, None)
            pairs[f"forces.{type(force).__name__}.{name}"] = (was, now)
    for name in vars(before.recording):
        pairs[f"recording.{name}"] = (getattr(before.recording, name), getattr(after.recording, name))
    return {
        name: {"before": np.asarray(was).tolist(), "after": np.asarray(now).tolist()}
        for name, (was, now) in pairs.items()
        if not np.array_equal(was, now)
    }
