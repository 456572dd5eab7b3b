"""The figures of an evaluation: which are drawn, and their files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tossid.motion import frames_in_flight
from tossid.objects import GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tossid.evaluation.evaluate import Scores


def score_figures(scores: Scores) -> dict[str, Figure]:
    """Figures of an evaluation by name.

    Errors over tosses and along rollouts; the median and the worst toss (by position) beside what was measured; what
    accelerates the object in the median toss; with joints, the learned geometry at several angles.

    Args:
        scores: Of `tossid.evaluate`.
    """
    from tossid.evaluation.figures import errors_along, errors_along_rollout, errors_over_tosses, toss_comparison

    name, nominal, tosses, rollouts = scores.model.name, scores.stated, scores.dataset.tosses, scores.rollouts()
    figures = {"errors_over_tosses": errors_over_tosses({name: scores.per_toss}, scores.names)}
    if (frames_in_flight(tosses, nominal) < [len(toss) for toss in tosses]).sum() > 1:
        figures["errors_along_rollout"] = errors_along_rollout({name: errors_along(tosses, rollouts, nominal)})
    for what, i in ranked(scores.per_toss.position_error_pct).items():
        toss = tosses[i]
        title = f"Toss {toss.name}, {what} position error of {len(tosses)}"
        figures[f"toss_comparison_{what}"] = toss_comparison(toss, {name: rollouts[i]}, nominal, title=title)
    return figures | acceleration_figure(scores) | _angles_figure(scores)


def acceleration_figure(scores: Scores) -> dict[str, Figure]:
    """Given dynamics, k_res and contact over the median toss; {} for a model that does not separate them.

    Args:
        scores: Of `tossid.evaluate`.
    """
    model = scores.model.model
    mechanics, median = model.mechanics(), ranked(scores.per_toss.position_error_pct).get("median")
    if median is None or mechanics is None:
        return {}
    from tossid.evaluation.figures import accelerations_over_toss, residual_over_toss

    toss = scores.dataset.tosses[median]
    true = model.measurement.true_toss(toss)
    parts = accelerations_over_toss(mechanics.system(), mechanics.object, true, weights=mechanics.weights)
    name = f"{scores.model.name.upper()}, {gravity_given(scores.model.settings.model.gravity)}"
    title = f"{name}: what accelerates the object"
    return {"residual_over_toss": residual_over_toss(parts, title=title, name=toss.name)}


def _angles_figure(scores: Scores) -> dict[str, Figure]:
    """Learned geometry at several joint angles, where there are joints and a geometry, and which corners touch."""
    stated, mechanics = scores.stated, scores.model.model.mechanics()
    if not stated.n_joints or mechanics is None:
        return {}
    from tossid.evaluation.figures import geometry_at_angles

    touched = np.any([run.lam_n.sum(axis=0) > 0 for run in scores.rollouts()], axis=0)
    title = f"Geometry learned by {scores.model.name.upper()}, at several joint angles"
    return {
        "geometry_at_angles": geometry_at_angles(
            stated, mechanics.object, seen=touched, truth_name="stated", title=title
        )
    }


def write_score_figures(scores: Scores, folder: Path) -> list[Path]:
    """Write each figure as NAME.png, and the median toss as toss_median.gif at half its speed.

    Args:
        scores: Of `tossid.evaluate`.
        folder: Made where it is missing.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in score_figures(scores).items():
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1])
    median = ranked(scores.per_toss.position_error_pct).get("median")
    return paths if median is None else [*paths, _write_film(scores, median, folder / "toss_median.gif")]


def _write_film(scores: Scores, index: int, path: Path) -> Path:
    from tossid.evaluation.figures import save_film, toss_film

    toss, rollout = scores.dataset.tosses[index], scores.rollouts()[index]
    film = toss_film(toss, rollout, scores.stated, name=scores.model.name)
    return save_film(film, path, frame_ms=10 * max(2, round(400 * float(np.median(np.diff(toss.t))))))


def gravity_given(gravity: float) -> str:
    """The given gravity in words, such as "given no gravity" or "given 1.5 times the true gravity".

    Args:
        gravity: [m/s²].
    """
    share = gravity / GRAVITY
    return f"given {share:.3g} times the true gravity" if share else "given no gravity"


def ranked(errors: NDArray[np.float64]) -> dict[str, int]:
    """Indices of the "median" and of the "worst" of the finite errors, where there are any.

    Args:
        errors: (B,), one a toss.
    """
    order = [int(i) for i in np.argsort(errors, kind="stable") if np.isfinite(errors[i])]
    if not order:
        return {}
    picked = {"median": order[(len(order) - 1) // 2]}
    return picked | ({"worst": order[-1]} if len(order) > 1 else {})
