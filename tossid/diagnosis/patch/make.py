"""The patch: what a diagnosis found, as changed MJCF and as changed keys of the object.

MJCF can express most effects, and some of them exactly. Where MuJoCo's law differs from the effect's own, the change
says so, and the rerun in MuJoCo shows what it is worth. Effects that MJCF cannot express are listed with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.errors import ObjectError
from tossid.objects import to_mjcf
from tossid.objects.files.model_file import first_line, read_model_file
from tossid.physics.effects import World
from tossid.physics.effects.mjcf_edit import Change, Edit
from tossid.physics.effects.mujoco_contact import write_compliance, write_rigid_contact
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP

ASSETS = "assets"
"""Folder beside patched.xml, with the files that it names."""


@dataclass(frozen=True)
class Patch:
    """Changes of a simulator.

    Attributes:
        mjcf: Text of the changed model.
        model: The changed model, compiled by MuJoCo: from its text, or from the file that nothing changes.
        changes: The changed attributes.
        keys: Changed numbers of tossid's own object and simulator: `before` and `after` by key.
        recording: By effect, how the recorded data are corrected where the recording is wrong, not the simulator.
        not_expressed: By effect, why MJCF cannot express it.
        assets: By name in the folder `ASSETS` beside the text's file, the user's file of a mesh or texture.
    """

    mjcf: str
    model: mujoco.MjModel
    changes: tuple[Change, ...]
    keys: dict[str, dict[str, Any]]
    recording: dict[str, str]
    not_expressed: dict[str, str]
    assets: dict[str, Path] = field(default_factory=dict)

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
            "assets": {name: str(path) for name, path in self.assets.items()},
        }


def make_patch(hypothesis: Hypothesis, *, mjcf: Path | None = None) -> Patch:
    """The changes from the base world of a hypothesis to the world with its effects, under its law of contact.

    A user's model keeps its contact under its own law. Under any other it is made as rigid as MuJoCo bears.

    Args:
        hypothesis: The world and its effects.
        mjcf: File of the user's own MuJoCo model; a scene of the base world with nearly rigid contact if None.

    Returns:
        The patch.

    Raises:
        ObjectError: MuJoCo cannot compile the model.
    """
    spec = read_spec(mjcf or _rigid_scene(hypothesis.base))
    edit = Edit(spec)
    world = hypothesis.base
    if mjcf is None and world.object.compliance > 0:  # what the base already has and rigid MJCF lacks
        write_compliance(edit, world, world)
        edit.changes.clear()
    if world.k_res is not None:
        edit.cannot["residual"] = "MJCF has no learned acceleration"
    if mjcf is not None and hypothesis.law.name != "own":
        edit.effect = "rigid contact"
        write_rigid_contact(edit)
    for effect, values in hypothesis.items():
        after = effect.at(world, values)
        edit.effect = effect.name
        effect.mjcf.write(edit, world, after)
        world = after
    model = edit.compiled()
    if mjcf is not None:
        _find_assets_from_anywhere(spec, mjcf.resolve().parent)
    text = spec.to_xml()
    if edit.changes:  # the text has fewer digits
        model = read_spec(text).compile()
    keys = _keys(hypothesis.base, world)
    text, assets = _with_own_assets(text)
    return Patch(text, model, tuple(edit.changes), keys, edit.recording, edit.cannot, assets)


def patched_model(hypothesis: Hypothesis, *, mjcf: Path | None = None) -> tuple[mujoco.MjModel, World]:
    """A MuJoCo model with a hypothesis's changes in it, and the world as which it is read.

    Args:
        hypothesis: What MJCF cannot express of it is in neither.
        mjcf: As of `make_patch`.
    """
    patch = make_patch(hypothesis, mjcf=mjcf)
    return patch.model, hypothesis.without(*patch.not_expressed).world()


def _with_own_assets(text: str) -> tuple[str, dict[str, Path]]:
    """A model whose files lie in the folder `ASSETS` beside it, so that both can be moved together, and these files."""
    root, assets = ElementTree.fromstring(text), dict[str, Path]()
    compiler = root.find("compiler")
    if compiler is None:
        return text, {}
    for asset in root.iterfind("asset/*"):
        place = Path(compiler.get("texturedir" if asset.tag == "texture" else "meshdir", ""))
        for key in [key for key in asset.attrib if key.startswith("file")]:
            source = place / asset.attrib[key]
            name = source.name if assets.get(source.name, source) == source else f"{len(assets)}-{source.name}"
            assets[name] = source
            asset.set(key, name)
    if not assets:
        return text, {}
    for key in ("meshdir", "texturedir"):
        compiler.set(key, ASSETS)
    return ElementTree.tostring(root, encoding="unicode"), assets


def _find_assets_from_anywhere(spec: mujoco.MjSpec, folder: Path) -> None:
    """Name the folders of a model's meshes and textures, where it has any: its text is for another place."""
    if any(mesh.file for mesh in spec.meshes) or any(field.file for field in spec.hfields):
        spec.meshdir = str(folder / spec.meshdir)
    if any(texture.file or any(texture.cubefiles) for texture in spec.textures):
        spec.texturedir = str(folder / spec.texturedir)


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
