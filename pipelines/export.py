"""`tossid export`: a learned model as MJCF or URDF, and how near MuJoCo's rollouts of it come to tossid's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.console import Console
from pipelines.schemas import ExportConfig
from tossid.errors import ConfigError, InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tossid.models.contactnets import ContactNets
    from tossid.objects import ObjectModel

FOLDER = Path("outputs/export")
SUFFIXES = {"mjcf": ".xml", "urdf": ".urdf"}

FLIGHTS, FLIGHT_S = 64, 0.5
"""Starts of the comparison in free flight, and its length [s]."""
DT = 1 / 148
STIFFEST = 2.0
"""Time steps that contact's own time, the root of compliance times mass, must have to be written as a spring."""
EXACT_STEPS = 32
"""tossid's steps a frame there: the comparison is of models, not of step lengths."""


def run(config: ExportConfig, console: Console) -> dict[str, Any]:
    """Export; returns the files, what could not be carried, and the comparison."""
    from pipelines.checkpoints import load_checkpoint
    from pipelines.outputs import output_file
    from pipelines.runs import find_run
    from tossid.models.contactnets import ContactNets
    from tossid.objects import to_urdf
    from tossid.physics.effects.in_mujoco import scene_text

    record = find_run(config.run)
    if record.checkpoint is None:
        raise InputError(f"run {record.name} ({record.id or record.folder}) has no checkpoint")
    trained = load_checkpoint(record.checkpoint)
    model = trained.model
    if not isinstance(model, ContactNets):
        raise InputError(
            f"run {record.name}: '{trained.config.name}' is a network of motion and holds no object to export"
        )
    suffix = SUFFIXES[config.format]
    out = config.out or FOLDER / f"{record.name}{suffix}"
    if out.suffix != suffix:
        raise ConfigError("out", f"'{out}' does not end in {suffix}, as format={config.format} does.")
    learned, gravity = model.learned_object(), model.carried_gravity()
    softness = float(np.sqrt(learned.compliance * learned.mass.sum()))
    too_stiff = 0 < softness < STIFFEST * config.timestep
    if too_stiff:
        learned = learned.with_changes(compliance=0.0, relaxation=0.0)
    out.parent.mkdir(parents=True, exist_ok=True)
    files = [out]
    if config.format == "mjcf":
        text = scene_text(learned, gravity=gravity, step=config.timestep)
    else:
        text, meshes = to_urdf(learned, meshes=out.stem)
        for name, mesh in meshes.items():
            files.append(out.with_name(name))
            with output_file(files[-1]) as temporary:
                temporary.write_text(mesh)
    with output_file(out) as temporary:
        temporary.write_text(text)

    left_out = _left_out(model, learned, config.format)
    if too_stiff:
        left_out.append(
            f"how contact gives way (within {1e3 * softness:.2g} ms): stiffer than time steps of "
            f"{1e3 * config.timestep:g} ms bear, so it is near rigid"
        )
    check = _check(model, learned, gravity, out, config)
    result = {
        "run": record.id,
        "model": trained.config.name,
        "format": config.format,
        "out": str(out),
        "files": [str(file) for file in files],
        "gravity_ms2": gravity,
        "left_out": left_out,
        "check": check,
    }
    keys = ("median_position_mm", "position_mm", "median_rotation_deg", "rotation_deg")
    rows = [[what.replace("_", " "), *(f"{check[what][key]:.2g}" for key in keys)] for what in check]
    heads = [f"MuJoCo against tossid, {FLIGHTS} starts, {FLIGHT_S} s", "median mm", "worst", "median deg", "worst "]
    console.table(heads, rows, title=f"wrote {out}")
    for text in left_out:
        console.say(f"not in the file: {text}")
    return result


def _left_out(model: ContactNets, learned: ObjectModel, form: str) -> list[str]:
    """What was learned and the format cannot say."""
    said = []
    if model.residual is not None:
        linear, angular = _rest(model)
        said.append(
            "the residual beyond a uniform vertical acceleration, in random flights "
            f"{linear:.2g} m/s² and {angular:.2g} rad/s² (rms)"
        )
    if learned.cohesion > 0:
        said.append(f"cohesion of {learned.cohesion:.2g} N")
    if form == "urdf":
        said.append("friction and softness of contact, and gravity: URDF has no words for them")
        if learned.joints.stiffness.any() or learned.joints.armature.any():
            said.append("joints' stiffness and armature")
    if model.measurement.length_scale != 1.0:
        said.append(
            f"the recording's length scale of {model.measurement.length_scale:.4f}: the file is in true lengths"
        )
    return said


def _rest(model: ContactNets) -> tuple[float, float]:
    """Root mean square of what the residual says beyond a uniform vertical acceleration [m/s²], [rad/s²]."""
    import torch

    from tossid.physics import make_system, tree_batch

    assert model.residual is not None
    batch = tree_batch(make_system(model.object), *_flights(model.object))
    with torch.no_grad():
        rest = model.residual.rest(torch.from_numpy(batch.features)).numpy()
    return float(np.sqrt((rest[:, :3] ** 2).sum(1).mean())), float(np.sqrt((rest[:, 3:] ** 2).sum(1).mean()))


def _flights(model: ObjectModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """States as of tosses, far above the ground."""
    rng = np.random.default_rng(0)
    q = np.concatenate([np.tile([0, 0, 10.0], (FLIGHTS, 1)), rng.normal(size=(FLIGHTS, 4))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    q = np.concatenate([q, rng.uniform(-2, 2, (FLIGHTS, model.n_joints))], axis=1)
    v = rng.normal(size=(FLIGHTS, model.nv)) * np.r_[1, 1, 1, np.full(model.nv - 3, 4)]
    return q, v


def _check(
    model: ContactNets, learned: ObjectModel, gravity: float, path: Path, config: ExportConfig
) -> dict[str, dict[str, float]]:
    """MuJoCo's rollouts of the file against tossid's of what it holds, and of the whole model."""
    from tossid.evaluation.exported import read_export, rollouts_apart
    from tossid.models.predictor import Simulator
    from tossid.objects import corner_positions
    from tossid.physics import make_system

    compiled = read_export(path)
    compiled.opt.gravity[:] = 0.0, 0.0, -gravity  # which URDF does not carry
    carried = Simulator(make_system(learned, gravity=gravity), substeps=EXACT_STEPS)
    q, v = _flights(learned)
    frames = round(FLIGHT_S / DT)
    fine = round(DT / 1e-4)

    def worst(predictor: Simulator, q: Any, substeps: int) -> dict[str, float]:
        apart = rollouts_apart(compiled, predictor, learned, q, v, frames=frames, dt=DT, substeps=substeps)
        median = {"median_position_mm": float(np.median(apart.position_mm))}
        median["median_rotation_deg"] = float(np.median(apart.rotation_deg))
        return {
            "position_mm": float(apart.position_mm.max()),
            "rotation_deg": float(apart.rotation_deg.max()),
            **median,
        }

    found = {"free_flight": worst(carried, q, fine)}
    if model.residual is not None:
        found["free_flight_with_residual"] = worst(Simulator(model.system(), substeps=EXACT_STEPS), q, fine)
    if config.format == "mjcf":
        low = q.copy()
        low[:, 2] += 0.1 - corner_positions(learned, q)[..., 2].min(axis=1)
        found["with_contact"] = worst(carried, low, max(1, round(DT / config.timestep)))
    return found
