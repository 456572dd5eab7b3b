"""The verb `tossid.export`: a learned object as MJCF or URDF, beside MuJoCo's rollouts of the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from tossid.errors import ConfigError, FileError, InputError
from tossid.html import html_table
from tossid.models import Mechanics, TrainedModel
from tossid.models.predictor import Predictor, Simulator
from tossid.objects import ObjectModel, body_poses, corner_heights, to_urdf
from tossid.outputs import write_whole
from tossid.physics import make_system, tree_batch
from tossid.physics.effects.in_mujoco import scene_text
from tossid.physics.mujoco_engine import quiet
from tossid.rotations import geodesic_angle
from tossid.settings.changed import changed
from tossid.settings.evaluation import ExportSettings

Array = NDArray[np.float64]

SUFFIXES = {"mjcf": ".xml", "urdf": ".urdf"}
UNSEEN_SITE = 2e-3
"""Radius of the site that marks a point that no toss has shown [m]."""
LEAST_CONTACT_STEPS = 2.0
"""Time steps that the contact time, the root of compliance times mass, must span to be written as a spring."""

FLIGHTS, FLIGHT_S, FRAME_S = 64, 0.5, 1 / 148
"""The comparison with MuJoCo: how many rollouts, their length and the time between the frames that are compared [s]."""
FLIGHT_STEP_S, SUBSTEPS = 1e-4, 32
"""MuJoCo's time step in free flight [s], and our steps a frame: the comparison is of models, not of step lengths."""


@dataclass(frozen=True)
class Distances:
    """How far MuJoCo's rollouts of an export are from ours: of each rollout, the largest over frames and bodies.

    Attributes:
        position_mm: The largest over rollouts, of the bodies' origins.
        rotation_deg: The largest over rollouts, of the bodies' rotations.
        median_position_mm: The median over rollouts.
        median_rotation_deg: The median over rollouts.
    """

    position_mm: float
    rotation_deg: float
    median_position_mm: float
    median_rotation_deg: float


@dataclass(frozen=True)
class Exported:
    """What `tossid.export` returns.

    Attributes:
        model: The name of the model.
        format: "mjcf" or "urdf".
        path: The file.
        files: It, and the meshes beside it.
        gravity_ms2: Downward acceleration of the model, which a URDF cannot carry.
        left_out: What the format cannot carry, in words.
        check: Distances of MuJoCo's rollouts: "free_flight" from ours of what the file holds,
            "free_flight_with_residual" from ours with all of k_res, "with_contact" (MJCF) with contact.
    """

    model: str
    format: str
    path: Path
    files: tuple[Path, ...]
    gravity_ms2: float
    left_out: tuple[str, ...]
    check: dict[str, Distances]

    def as_json(self) -> dict[str, Any]:
        """The export as plain values."""
        return {
            "model": self.model,
            "format": self.format,
            "out": str(self.path),
            "files": [str(path) for path in self.files],
            "gravity_ms2": self.gravity_ms2,
            "left_out": list(self.left_out),
            "check": {name: asdict(found) for name, found in self.check.items()},
        }

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows of a table of the comparison."""
        starts = f"MuJoCo against tossid, {FLIGHTS} starts, {FLIGHT_S:g} s"
        rows = [
            [
                name.replace("_", " "),
                *(f"{x:.2g}" for x in (found.median_position_mm, found.position_mm)),
                *(f"{x:.2g}" for x in (found.median_rotation_deg, found.rotation_deg)),
            ]
            for name, found in self.check.items()
        ]
        return [starts, "median mm", "worst", "median deg", "worst "], rows

    def _repr_html_(self) -> str:
        missing = "".join(f"<li>not in the file: {escape(text)}</li>" for text in self.left_out)
        return f"<p><b>{escape(str(self.path))}</b></p>{html_table(*self.table())}<ul>{missing}</ul>"


def export(
    model: TrainedModel, path: str | Path, *, settings: ExportSettings = ExportSettings(), **keys: Any
) -> Exported:
    """A learned object in a file that MuJoCo reads, and a comparison of MuJoCo's rollouts of it with ours.

    Args:
        model: A trained model that holds an object (not a network of motion).
        path: The file; it ends in .xml (MJCF) or .urdf, as the format does.
        settings: Format and time step.
        **keys: Settings by name, such as `format="urdf"`.

    Returns:
        The files, what they cannot carry, and how near the rollouts are.

    Raises:
        InputError: The model holds no object.
        ConfigError: The path does not end as the format does, or a key is no setting.
        OutputError: The disk refuses.
    """
    settings, path = changed(settings, keys), Path(path)
    suffix = SUFFIXES[settings.format]
    if path.suffix != suffix:
        raise ConfigError("out", f"'{path}' does not end in {suffix}, as format={settings.format} does.")
    learned = model.model.mechanics()
    if learned is None:
        raise InputError(f"'{model.name}' is a network of motion and holds no object to export")
    carried, gravity, unseen = learned.object, learned.carried_gravity, unseen_points(model)
    softness = float(np.sqrt(carried.compliance * carried.mass.sum()))
    too_stiff = 0 < softness < LEAST_CONTACT_STEPS * settings.timestep
    if too_stiff:
        carried = carried.with_changes(compliance=0.0, relaxation=0.0)
    left_out = _left_out(learned, carried, model.model.measurement.length_scale)
    if settings.format == "mjcf":
        text = scene_text(carried, gravity=gravity, step=settings.timestep)
        texts = {path: _marked(text, unseen, model.model.measurement.length_scale)}
    else:
        text, meshes = to_urdf(carried, meshes=path.stem)
        texts = {path: text, **{path.with_name(name): mesh for name, mesh in meshes.items()}}
        left_out.append("friction and softness of contact, and gravity: URDF has no words for them")
        if carried.joints.stiffness.any() or carried.joints.armature.any():
            left_out.append("joints' stiffness and armature")
        if unseen:
            count = sum(map(len, unseen.values()))
            left_out.append(f"that {count} points of its surface never came down to the ground")
    if too_stiff:
        left_out.append(
            f"how contact gives way (within {1e3 * softness:.2g} ms): stiffer than time steps of "
            f"{1e3 * settings.timestep:g} ms bear, so it is near rigid"
        )
    for file, text in texts.items():
        write_whole(file, text.encode())
    check = _compared(learned, carried, path, settings)
    return Exported(model.name, settings.format, path, tuple(texts), gravity, tuple(left_out), check)


def unseen_points(model: TrainedModel) -> dict[str, Array]:
    """Points of the learned shape that no toss brought down to the ground (n, 3), by body, in recorded lengths [m]."""
    found = {}
    for name, link in zip(model.object.body_names, model.parameters.get("geometry", ()), strict=False):
        points = np.array(link["vertices_m"]).reshape(-1, 3)[~np.array(link["seen"], dtype=bool)]
        if len(points):
            found[name] = points
    return found


def _marked(text: str, unseen: dict[str, Array], length_scale: float) -> str:
    """MJCF with a site `unseen_BODY_NUMBER` at each point that no toss has shown."""
    if not unseen:
        return text
    spec = mujoco.MjSpec.from_string(text)
    for name, points in unseen.items():
        for number, point in enumerate(points / length_scale):
            mark: dict[str, Any] = {"size": [UNSEEN_SITE] * 3, "rgba": [0.76, 0.25, 0.05, 1.0]}
            spec.body(name).add_site(name=f"unseen_{name}_{number}", pos=point, **mark)
    spec.compile()
    return str(spec.to_xml())


def read_export(path: Path) -> mujoco.MjModel:
    """An exported file, as MuJoCo reads it; a URDF's base is given a free joint, as MuJoCo fixes it to the world.

    Args:
        path: MJCF or URDF.

    Raises:
        FileError: MuJoCo cannot read it.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for root in spec.worldbody.bodies:
            if not list(root.joints):
                root.add_freejoint()
        return spec.compile()
    except ValueError as error:
        raise FileError(path, f"MuJoCo cannot read the export: {error}") from error


def _left_out(learned: Mechanics, carried: ObjectModel, length_scale: float) -> list[str]:
    """What was learned and neither format can carry."""
    found = []
    if learned.k_res is not None:
        batch = tree_batch(make_system(learned.object), *_flights(learned.object))
        rest = learned.k_res_without_vertical(batch.features)
        linear, angular = (float(np.sqrt((part**2).sum(1).mean())) for part in (rest[:, :3], rest[:, 3:]))
        found.append(
            "k_res beyond a uniform vertical acceleration, in random flights "
            f"{linear:.2g} m/s² and {angular:.2g} rad/s² (rms)"
        )
    if carried.cohesion > 0:
        found.append(f"cohesion of {carried.cohesion:.2g} N")
    if length_scale != 1.0:
        found.append(f"the recording's length scale of {length_scale:.4f}: the file is in true lengths")
    return found


def _flights(model: ObjectModel) -> tuple[Array, Array]:
    """First states as of tosses, far above the ground: q (B, nq), v (B, nv)."""
    rng = np.random.default_rng(0)
    q = np.concatenate([np.tile([0, 0, 10.0], (FLIGHTS, 1)), rng.normal(size=(FLIGHTS, 4))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    q = np.concatenate([q, rng.uniform(-2, 2, (FLIGHTS, model.n_joints))], axis=1)
    v = rng.normal(size=(FLIGHTS, model.nv)) * np.r_[1, 1, 1, np.full(model.nv - 3, 4)]
    return q, v


def _compared(learned: Mechanics, carried: ObjectModel, path: Path, settings: ExportSettings) -> dict[str, Distances]:
    """MuJoCo's rollouts of the file beside ours of what it holds, and of the whole model."""
    compiled = read_export(path)
    if (compiled.nq, compiled.nv) != (carried.nq, carried.nv):
        raise InputError(f"the export has {compiled.nq} coordinates, the model {carried.nq}")
    compiled.opt.gravity[:] = 0.0, 0.0, -learned.carried_gravity  # which URDF does not carry
    ours = Simulator(make_system(carried, gravity=learned.carried_gravity), substeps=SUBSTEPS)
    q, v = _flights(carried)

    def compare(predictor: Predictor, q: Array, step: float) -> Distances:
        frames, substeps = round(FLIGHT_S / FRAME_S), max(1, round(FRAME_S / step))
        compiled.opt.timestep = FRAME_S / substeps
        start = np.concatenate([np.zeros((len(q), 1)), q, v], axis=1)
        with quiet():
            states, _ = rollout.rollout(compiled, mujoco.MjData(compiled), start, nstep=frames * substeps)
        theirs = np.asarray(states)[:, substeps - 1 :: substeps, 1 : 1 + carried.nq]
        predicted = predictor.rollout(q, v, n_steps=frames, dt=FRAME_S).q[:, 1:]
        (x, a), (y, b) = body_poses(carried, predicted), body_poses(carried, theirs)
        position = 1e3 * np.linalg.norm(x - y, axis=-1).max(axis=(1, 2))
        rotation = np.rad2deg(geodesic_angle(a, b).max(axis=(1, 2)))
        return Distances(*(float(f(each)) for f in (np.max, np.median) for each in (position, rotation)))

    found = {"free_flight": compare(ours, q, FLIGHT_STEP_S)}
    if learned.k_res is not None:
        whole = Simulator(learned.system(), substeps=SUBSTEPS)
        found["free_flight_with_residual"] = compare(whole, q, FLIGHT_STEP_S)
    if settings.format == "mjcf":
        low = q.copy()
        low[:, 2] += 0.1 - corner_heights(carried, q).min(axis=1)
        found["with_contact"] = compare(ours, low, settings.timestep)
    return found
