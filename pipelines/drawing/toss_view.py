"""What `tossid view` shows of a dataset, of a run's rollouts, and of a gap report."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console
from pipelines.config.schemas import ViewConfig
from pipelines.drawing.recording_view import Moving, ViewContent, moving_bodies
from pipelines.files.project import dataset_path
from tossid.errors import FileError, InputError
from tossid.objects import ObjectModel
from tossid.store import Dataset, read_dataset
from tossid.types import PoseTrack, Toss, frame_time

Array = NDArray[np.float64]

PAUSE = 0.3
"""Between tosses that are shown one after another [s]."""
FAR = 1e2
"""A rollout that gets so far is lost [m]."""


def toss_content(config: ViewConfig, console: Console) -> ViewContent:
    """Tosses of a dataset one after another, with a run's rollouts of them or with those of a gap's simulators."""
    report, beside = (None, Path()) if config.gap is None else _read_gap(config.gap)
    trained, path = None, config.data
    if config.run is not None:
        from pipelines.tracking.runs import find_run

        trained = find_run(config.run).trained_model()
    held_out = trained is not None and path is None
    if path is None and trained is not None:
        path = trained.data
    if path is None and report is not None:
        path = Path(report["data"]["path"])
        if not path.is_file():
            raise FileError(path, "the gap's dataset is not here; name it with data=FILE.h5")
    path = dataset_path(path)
    dataset = read_dataset(path)
    tosses = in_a_row(dataset.of_split("test") if held_out else dataset.tosses)
    last = config.start_s + config.seconds if config.seconds is not None else np.inf
    tosses = tuple(t for t in tosses if config.start_s <= t.t[-1] - tosses[0].t[0] and t.t[0] - tosses[0].t[0] <= last)
    if not tosses:
        raise InputError(f"{path}: no {'held-out ' * held_out}toss to show from start_s={config.start_s:g} on")
    model: ObjectModel = dataset.object
    if trained is not None and not model.is_stated:
        model = trained.object
    rollouts: dict[str, Sequence[Array]] = {}
    if trained is not None:
        from tossid.evaluation.evaluate import predicted_motions

        rollouts["predicted"] = [motion.q for motion in predicted_motions(trained.model, model, tosses)]
    if report is not None:
        rollouts |= gap_rollouts(report, dataset, tosses, console, beside=beside)
    moving = _bodies([(t.t, t.q, t.q_cov) for t in tosses], model)
    predicted = {
        name: _bodies([(toss.t, q, None) for toss, q in zip(tosses, motions, strict=True)], model)
        for name, motions in rollouts.items()
    }
    console.say(f"{len(tosses)} tosses of {path}" + " (held out)" * held_out)
    name = config.gap.resolve().name if report is not None and config.gap is not None else path.stem
    notes = in_words(report) if report is not None else ""
    return ViewContent(name.removesuffix(".json"), moving=moving, tosses=tosses, predicted=predicted, notes=notes)


def in_a_row(tosses: Sequence[Toss]) -> tuple[Toss, ...]:
    """Tosses at times that do not overlap: their own where these do not, else one after another from 0."""
    if all(before.t[-1] < after.t[0] for before, after in itertools.pairwise(tosses)):
        return tuple(tosses)
    found, start = [], 0.0
    for toss in tosses:
        found.append(replace(toss, t=toss.t - toss.t[0] + start))
        start = float(found[-1].t[-1]) + PAUSE
    return tuple(found)


def _bodies(pieces: Sequence[tuple[Array, Array, Array | None]], model: ObjectModel) -> tuple[Moving, ...]:
    """An object's bodies in motions one after another, each up to where it is lost."""
    kept = []
    for t, q, cov in pieces:
        near = np.isfinite(q).all(axis=1) & (np.abs(np.nan_to_num(q[:, :3], nan=np.inf)).max(axis=1) < FAR)
        n = int(np.logical_and.accumulate(near).sum())
        kept.append((t[:n], q[:n], None if cov is None else cov[:n]))
    if sum(len(t) for t, _, _ in kept) < 2:
        return ()
    covs = [cov for _, _, cov in kept if cov is not None]
    track = PoseTrack(
        model.name,
        np.concatenate([t for t, _, _ in kept]),
        np.concatenate([q for _, q, _ in kept]),
        np.concatenate(covs) if len(covs) == len(kept) else None,
    )
    return moving_bodies({model.name: track}, None, model)


def _read_gap(path: Path) -> tuple[dict[str, Any], Path]:
    """A gap.json, or the one in a folder that `diagnose` wrote, and its folder."""
    file = path / "gap.json" if path.is_dir() else path
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileError(file, "is no gap report; 'tossid diagnose' makes one") from error
    if not isinstance(report, dict) or not str(report.get("schema", "")).startswith("tossid.gap/"):
        raise FileError(file, "is no gap report; 'tossid diagnose' makes one")
    return report, file.parent


def gap_rollouts(
    report: dict[str, Any], dataset: Dataset, tosses: Sequence[Toss], console: Console, *, beside: Path
) -> dict[str, Sequence[Array]]:
    """Open-loop motions (n, 7) of each toss, from a first state that is estimated from its flight.

    "stated" is the stated object in rigid contact, where that was diagnosed. "patched" is the gap's patched model in
    MuJoCo, with the meshes and textures that lie beside the report.
    """
    import shutil
    import tempfile

    from tossid.diagnosis.likelihood.windows import make_windows
    from tossid.diagnosis.localisation.rollouts import rolled_out
    from tossid.diagnosis.patch.make import ASSETS
    from tossid.physics.effects import World

    runs: dict[str, Sequence[Array]] = {}
    if report.get("simulator", {}).get("sim") == "nominal":
        world = World(dataset.object)
        runs["stated"] = rolled_out(tosses, world, make_windows(tosses, world.object))
    patch = report.get("patch", {})
    if patch.get("mjcf"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "patched.xml"
            path.write_text(patch["mjcf"], encoding="utf-8")
            if patch.get("assets"):
                shutil.copytree(beside / ASSETS, Path(folder) / ASSETS)
            runs["patched"] = in_mujoco(path, tosses, width=dataset.object.width)
    if patch.get("recording"):
        console.warn(f"rollouts are not corrected for what is wrong of the recording: {', '.join(patch['recording'])}")
    return runs


def in_mujoco(mjcf: Path, tosses: Sequence[Toss], *, width: float) -> list[Array]:
    """Motions (n, 7) of tosses in a user's MuJoCo model, each from what its free flight says of its start.

    Args:
        mjcf: The model.
        tosses: As measured.
        width: Of the object [m].
    """
    from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
    from tossid.diagnosis.likelihood.windows import make_windows
    from tossid.diagnosis.localisation.rollouts import at_frames, first_states
    from tossid.diagnosis.simulators import world_of_mjcf

    world, model = world_of_mjcf(mjcf, width=width)
    simulated = MujocoWorld(model, replace(world, ground_height=0.0, ground_tilt=(0.0, 0.0)))
    first = first_states(tosses, world, make_windows(tosses, world.object))
    return at_frames(tosses, first, frame_time(tosses), simulated.roll_out)


def in_words(report: dict[str, Any]) -> str:
    """A gap report's conclusion, as Markdown."""
    total, verdict = report["gap"]["total"], report["explanation"]["verdict"].replace("_", " ")
    lines = [
        f"# {report['simulator']['about']}",
        f"Verdict: **{verdict}**. Gap: {total['value']:.2f} {total['unit']}.",
        "",
    ]
    for change in report["change"]:
        lines.append(f"- {change['name']} {change['parameter']}: {change['from']:.4g}, found {change['to']:.4g}")
    return "\n".join(lines) + "\n"
