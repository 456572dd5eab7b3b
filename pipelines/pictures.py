"""Figures of a training, of an evaluation and of a study, as files: which are drawn, and where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.learning import Judged, Trained
from pipelines.outputs import output_file
from tossid.models.contactnets import ContactNets
from tossid.models.protocol import DynamicsModel
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import Rollout, Toss

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def training_figures(trained: Trained, *, name: str) -> dict[str, Figure]:
    """Curves over epochs, and the geometry before and after."""
    from tossid.evaluation.figures import learned_geometry, training_curves

    return {
        "training_curves": training_curves(trained.history, title=f"Training {name}"),
        "learned_geometry": learned_geometry(
            trained.model.object, trained.model.learned_object(), title=f"Geometry learned by {name}"
        ),
    }


def evaluation_figures(
    judged: Judged, tosses: Sequence[Toss], rollouts: Sequence[Rollout], nominal: ObjectModel, *, name: str
) -> dict[str, Figure]:
    """Errors over tosses and along rollouts; the median and the worst toss (by position) side by side with measured."""
    from tossid.evaluation.figures import errors_along, errors_along_rollout, errors_over_tosses, toss_comparison
    from tossid.motion import flight_frames

    figures = {"errors_over_tosses": errors_over_tosses({name: judged.scores}, judged.names)}
    if sum(flight_frames(toss, nominal) < len(toss) for toss in tosses) > 1:
        figures["errors_along_rollout"] = errors_along_rollout({name: errors_along(tosses, rollouts, nominal)})
    for what, i in ranked(judged.scores.position_error_pct).items():
        toss = tosses[i]
        title = f"Toss {toss.name}, {what} position error of {len(tosses)}"
        figures[f"toss_comparison_{what}"] = toss_comparison(toss, {name: rollouts[i]}, nominal, title=title)
    return figures


def joint_figure(
    model: DynamicsModel, rollouts: Sequence[Rollout], stated: ObjectModel, *, name: str
) -> dict[str, Figure]:
    """Learned geometry at several joint angles, where there are joints and a geometry; which corners touch is seen in
    the model's rollouts."""
    if not stated.n_joints or not isinstance(model, ContactNets):
        return {}
    from tossid.evaluation.figures import geometry_at_angles

    seen = np.any([run.lam_n.sum(axis=0) > 0 for run in rollouts], axis=0)
    title = f"Geometry learned by {name}, at several joint angles"
    return {
        "geometry_at_angles": geometry_at_angles(
            stated, model.learned_object(), seen=seen, truth_name="stated", title=title
        )
    }


def write_film(
    judged: Judged,
    tosses: Sequence[Toss],
    rollouts: Sequence[Rollout],
    stated: ObjectModel,
    folder: Path,
    *,
    name: str,
) -> list[Path]:
    """The median toss's film as FOLDER/toss_median.gif, at half its speed; returns its path."""
    from PIL import Image

    from tossid.evaluation.figures import toss_film

    median = ranked(judged.scores.position_error_pct).get("median")
    if median is None:
        return []
    toss = tosses[median]
    frames = [Image.fromarray(frame) for frame in toss_film(toss, rollouts[median], stated, name=name)]
    path, dt = folder / "toss_median.gif", float(np.median(np.diff(toss.t)))
    with output_file(path) as temporary:
        frames[0].save(
            temporary, save_all=True, append_images=frames[1:], duration=10 * max(2, round(400 * dt)), loop=0
        )
    return [path]


def residual_figure(model: DynamicsModel, judged: Judged, tosses: Sequence[Toss], *, name: str) -> dict[str, Figure]:
    """Given dynamics, residual and contact over the median toss; {} for a model that does not tell them apart."""
    median = ranked(judged.scores.position_error_pct).get("median")
    if median is None or not isinstance(model, ContactNets):
        return {}
    from tossid.evaluation.figures import accelerations_over_toss, residual_over_toss

    toss = tosses[median]
    parts = accelerations_over_toss(
        model.system(), model.learned_object(), model.measurement.true_toss(toss), weights=model.settings.weights
    )
    title = f"{name}: what accelerates the object"
    return {"residual_over_toss": residual_over_toss(**vars(parts), title=title, name=toss.name)}


def gravity_given(gravity: float) -> str:
    """ "given no gravity", "given 1.5 times the true gravity" """
    share = gravity / GRAVITY
    return f"given {share:.3g} times the true gravity" if share else "given no gravity"


def ranked(errors: np.ndarray) -> dict[str, int]:
    """Indices of the median and of the worst of the finite errors (B,)."""
    order = [int(i) for i in np.argsort(errors, kind="stable") if np.isfinite(errors[i])]
    if not order:
        return {}
    picked = {"median": order[(len(order) - 1) // 2]}
    return picked | ({"worst": order[-1]} if len(order) > 1 else {})


def sweep_figures(key: str, cells: Sequence[dict[str, Any]], *, measured_penetration_mm: float) -> dict[str, Figure]:
    """The study's metrics against the swept value, from the first state and from the flight; {} for other keys."""
    from tossid.evaluation.figures import data_efficiency, gravity_sweep, inertia_study

    if key == "model.start_inertia":
        return {"inertia_study": inertia_study(cells)}
    starts = [False] + ([True] if all("from_flight" in cell for cell in cells) else [])
    figures: dict[str, Figure] = {}
    for from_flight in starts:
        suffix = "_from_flight" if from_flight else ""
        if key == "model.gravity":
            figures[f"gravity_sweep{suffix}"] = gravity_sweep(
                cells, measured_penetration_mm=measured_penetration_mm, from_flight=from_flight
            )
        elif key == "tosses":
            figures[f"data_efficiency{suffix}"] = data_efficiency(cells, swept="tosses", from_flight=from_flight)
    return figures


def write_figures(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write each as NAME.png into the folder; returns the paths."""
    paths = []
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        with output_file(path) as temporary:
            figure.savefig(temporary)
        paths.append(path)
    return paths
