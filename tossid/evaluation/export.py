"""The verb `tossid.export`: a learned object as MJCF or URDF, beside MuJoCo's rollouts of the file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
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
from tossid.motion import MeasurementModel
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
        starts: How many rollouts were compared.
        seconds: How long they were.
    """

    model: str
    format: str
    path: Path
    files: tuple[Path, ...]
    gravity_ms2: float
    left_out: tuple[str, ...]
    check: dict[str, Distances]
    starts: int = field(repr=False)
    seconds: float = field(repr=False)

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
        starts = f"MuJoCo against tossid, {self.starts} starts, {self.seconds:g} s"
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
        settings: Format, time step, and the comparison.
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
    carried, softness = _carried(learned.object, settings)
    texts = _texts(carried, learned.carried_gravity, path, settings)
    if settings.format == "mjcf":
        texts[path] = _marked(texts[path], unseen_points(model), model.model.measurement.length_scale)
    for file, text in texts.items():
        write_whole(file, text.encode())
    left_out = _left_out(learned, carried, model.model.measurement, settings)
    unseen = unseen_points(model)
    if unseen and settings.format == "urdf":
        left_out.append(f"that {sum(map(len, unseen.values()))} points of its surface never came down to the ground")
    if carried is not learned.object:
        left_out.append(
            f"how contact gives way (within {1e3 * softness:.2g} ms): stiffer than time steps of "
            f"{1e3 * settings.timestep:g} ms bear, so it is near rigid"
        )
    return Exported(
        model.name,
        settings.format,
        path,
        tuple(texts),
        learned.carried_gravity,
        tuple(left_out),
        _compared(learned, carried, path, settings),
        settings.flights,
        settings.flight_s,
    )


def unseen_points(model: TrainedModel) -> dict[str, Array]:
    """Points of the learned shape that no toss brought down to the ground (n, 3), by body, in recorded lengths [m].

    Args:
        model: A trained model.
    """
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


UNSEEN_SITE = 2e-3
"""Radius of the site that marks a point that no toss has shown [m]."""


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


def rollout_distances(
    compiled: mujoco.MjModel,
    predictor: Predictor,
    model: ObjectModel,
    starts: tuple[Array, Array],
    *,
    frames: int,
    dt: float,
    substeps: int,
) -> Distances:
    """Roll the same first states out in MuJoCo and by a predictor, and compare.

    Args:
        compiled: The export; its time step becomes dt / substeps.
        predictor: Ours.
        model: The learned object; its order of q and v is the export's.
        starts: q0 (B, nq) and v0 (B, nv).
        frames: After the first.
        dt: Between frames [s].
        substeps: MuJoCo's steps a frame.

    Raises:
        InputError: The export has other joints than the object.
    """
    if (compiled.nq, compiled.nv) != (model.nq, model.nv):
        raise InputError(f"the export has {compiled.nq} coordinates, the model {model.nq}")
    q0, v0 = starts
    compiled.opt.timestep = dt / substeps
    start = np.concatenate([np.zeros((len(q0), 1)), q0, v0], axis=1)
    with quiet():
        states, _ = rollout.rollout(compiled, mujoco.MjData(compiled), start, nstep=frames * substeps)
    theirs = np.asarray(states)[:, substeps - 1 :: substeps, 1 : 1 + model.nq]
    ours = predictor.rollout(q0, v0, n_steps=frames, dt=dt).q[:, 1:]
    (x, a), (y, b) = body_poses(model, ours), body_poses(model, theirs)
    position = 1e3 * np.linalg.norm(x - y, axis=-1).max(axis=(1, 2))
    rotation = np.rad2deg(geodesic_angle(a, b).max(axis=(1, 2)))
    return Distances(
        float(position.max()), float(rotation.max()), float(np.median(position)), float(np.median(rotation))
    )


def _carried(learned: ObjectModel, settings: ExportSettings) -> tuple[ObjectModel, float]:
    """The object as the file has it (with rigid contact where it is too stiff), and its contact time [s]."""
    softness = float(np.sqrt(learned.compliance * learned.mass.sum()))
    if 0 < softness < settings.least_contact_steps * settings.timestep:
        return learned.with_changes(compliance=0.0, relaxation=0.0), softness
    return learned, softness


def _texts(carried: ObjectModel, gravity: float, path: Path, settings: ExportSettings) -> dict[Path, str]:
    """The content of each file."""
    if settings.format == "mjcf":
        return {path: scene_text(carried, gravity=gravity, step=settings.timestep)}
    text, meshes = to_urdf(carried, meshes=path.stem)
    return {path: text, **{path.with_name(name): mesh for name, mesh in meshes.items()}}


def _left_out(
    learned: Mechanics, carried: ObjectModel, measurement: MeasurementModel, settings: ExportSettings
) -> list[str]:
    """What was learned and the format cannot carry."""
    found = []
    if learned.k_res is not None:
        given = learned.object
        batch = tree_batch(make_system(given), *_flights(given, settings))
        rest = learned.k_res_without_vertical(batch.features)
        linear, angular = (float(np.sqrt((part**2).sum(1).mean())) for part in (rest[:, :3], rest[:, 3:]))
        found.append(
            "k_res beyond a uniform vertical acceleration, in random flights "
            f"{linear:.2g} m/s² and {angular:.2g} rad/s² (rms)"
        )
    if carried.cohesion > 0:
        found.append(f"cohesion of {carried.cohesion:.2g} N")
    if settings.format == "urdf":
        found.append("friction and softness of contact, and gravity: URDF has no words for them")
        if carried.joints.stiffness.any() or carried.joints.armature.any():
            found.append("joints' stiffness and armature")
    if measurement.length_scale != 1.0:
        found.append(f"the recording's length scale of {measurement.length_scale:.4f}: the file is in true lengths")
    return found


def _flights(model: ObjectModel, settings: ExportSettings) -> tuple[Array, Array]:
    """First states as of tosses, far above the ground: q (B, nq), v (B, nv)."""
    rng, count = np.random.default_rng(settings.seed), settings.flights
    q = np.concatenate([np.tile([0, 0, 10.0], (count, 1)), rng.normal(size=(count, 4))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    q = np.concatenate([q, rng.uniform(-2, 2, (count, model.n_joints))], axis=1)
    v = rng.normal(size=(count, model.nv)) * np.r_[1, 1, 1, np.full(model.nv - 3, 4)]
    return q, v


def _compared(learned: Mechanics, carried: ObjectModel, path: Path, settings: ExportSettings) -> dict[str, Distances]:
    """MuJoCo's rollouts of the file beside ours of what it holds, and of the whole model."""
    compiled = read_export(path)
    compiled.opt.gravity[:] = 0.0, 0.0, -learned.carried_gravity  # which URDF does not carry
    ours = Simulator(make_system(carried, gravity=learned.carried_gravity), substeps=settings.substeps)
    q, v = _flights(carried, settings)
    dt, frames = settings.frame_s, round(settings.flight_s / settings.frame_s)

    def compare(predictor: Predictor, q: Array, step: float) -> Distances:
        substeps = max(1, round(dt / step))
        return rollout_distances(compiled, predictor, carried, (q, v), frames=frames, dt=dt, substeps=substeps)

    found = {"free_flight": compare(ours, q, settings.flight_step_s)}
    if learned.k_res is not None:
        whole = Simulator(learned.system(), substeps=settings.substeps)
        found["free_flight_with_residual"] = compare(whole, q, settings.flight_step_s)
    if settings.format == "mjcf":
        low = q.copy()
        low[:, 2] += 0.1 - corner_heights(carried, q).min(axis=1)
        found["with_contact"] = compare(ours, low, settings.timestep)
    return found
