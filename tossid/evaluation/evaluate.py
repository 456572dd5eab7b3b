"""The verb `tossid.evaluate`: open-loop rollouts of a trained model beside measured tosses, with their figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.metrics import TossScores, joined, roll_out, score_tosses, score_windows, summarize_scores
from tossid.html import html_table, number_words
from tossid.models import TrainedModel
from tossid.models.protocol import DynamicsModel
from tossid.motion import frames_in_flight
from tossid.objects import GRAVITY, ObjectModel
from tossid.plain_json import jsonable
from tossid.settings.changed import changed
from tossid.settings.evaluation import EvaluateSettings
from tossid.store import Dataset
from tossid.types import OnDemand, Progress, Rollout, Toss, frame_time

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTS = ("from_flight", "sixteen_steps")
"""Keys of the metrics of other starts: the first state as the flight gives it, and short rollouts."""


@dataclass(frozen=True)
class Scores:
    """What `tossid.evaluate` returns.

    Attributes:
        model: What was evaluated.
        dataset: On which tosses.
        metrics: Position, rotation, penetration and gravity, each {"mean", "ci95"} over tosses; the same under
            "from_flight" for an object without joints and under "sixteen_steps"; and the counts "unsolved" and
            "diverged".
        per_toss: The scores of each toss, from its first state.
        dt: Time between frames of the rollouts [s].
    """

    model: TrainedModel
    dataset: Dataset = field(repr=False)
    metrics: dict[str, Any]
    per_toss: TossScores = field(repr=False)
    dt: float

    @property
    def names(self) -> tuple[str, ...]:
        """The tosses' names."""
        return tuple(toss.name for toss in self.dataset.tosses)

    @property
    def stated(self) -> ObjectModel:
        """The object whose centre, width and corners are those of the metrics."""
        return stated_object(self.model, self.dataset)

    def as_json(self) -> dict[str, Any]:
        """The metrics with the model's name and what it learned, as plain values."""
        result = {"model": self.model.name, "n_tosses": len(self.dataset.tosses), **self.metrics}
        plain: dict[str, Any] = jsonable({**result, "parameters": self.model.parameters})
        return plain

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows of a table: a metric with its interval from each start."""
        head = ["metric", "mean", "95 % interval", "from flight", "95 % interval", "16 steps", "95 % interval"]
        rows = []
        for name, value in self.metrics.items():
            if isinstance(value, dict) and "mean" in value:
                starts = [value, *(self.metrics.get(part, {}).get(name) for part in PARTS)]
                rows.append([name, *(cell for start in starts for cell in _cells(start))])
        return head, rows

    def rollouts(self) -> OnDemand[Rollout]:
        """The motions that were scored, rolled out again when they are asked for."""
        return predicted_motions(self.model.model, self.stated, self.dataset.tosses, dt=self.dt)

    def figures(self) -> dict[str, Figure]:
        """Figures by name.

        Errors over tosses and along rollouts; the median and the worst toss (by position) beside what was measured;
        what accelerates the object in the median toss; with joints, the learned geometry at several angles.
        """
        from tossid.evaluation.figures import errors_along, errors_along_rollout, errors_over_tosses, toss_comparison

        name, nominal, tosses, rollouts = self.model.name, self.stated, self.dataset.tosses, self.rollouts()
        figures = {"errors_over_tosses": errors_over_tosses({name: self.per_toss}, self.names)}
        if (frames_in_flight(tosses, nominal) < [len(toss) for toss in tosses]).sum() > 1:
            figures["errors_along_rollout"] = errors_along_rollout({name: errors_along(tosses, rollouts, nominal)})
        for rank, i in ranked(self.per_toss.position_error_pct).items():
            place = f", {rank} position error of {len(tosses)}" if len(tosses) > 1 else ""
            title = f"Toss {tosses[i].name}{place}"
            figures[f"toss_comparison_{rank}"] = toss_comparison(tosses[i], {name: rollouts[i]}, nominal, title=title)
        return figures | self.acceleration_figure() | self._angles_figure()

    def acceleration_figure(self) -> dict[str, Figure]:
        """Given dynamics, k_res and contact over the median toss; {} for a model that does not separate them."""
        model = self.model.model
        mechanics, median = model.mechanics(), ranked(self.per_toss.position_error_pct).get("median")
        if median is None or mechanics is None:
            return {}
        from tossid.evaluation.accelerations import accelerations_over_toss
        from tossid.evaluation.figures import residual_over_toss

        toss = self.dataset.tosses[median]
        true = model.measurement.true_toss(toss)
        parts = accelerations_over_toss(mechanics.system(), mechanics.object, true, weights=mechanics.weights)
        given = self.model.settings.model.gravity / GRAVITY
        gravity = f"given {given:.3g} times the true gravity" if given else "given no gravity"
        title = f"{self.model.name.upper()}, {gravity}: what accelerates the object"
        return {"residual_over_toss": residual_over_toss(parts, title=title, name=toss.name)}

    def _angles_figure(self) -> dict[str, Figure]:
        """Learned geometry at several joint angles, where there are joints and a geometry, and which corners touch."""
        stated, mechanics = self.stated, self.model.model.mechanics()
        if not stated.n_joints or mechanics is None:
            return {}
        from tossid.evaluation.figures import geometry_at_angles

        touched = np.any([run.lam_n.sum(axis=0) > 0 for run in self.rollouts()], axis=0)
        title = f"Geometry learned by {self.model.name.upper()}, at several joint angles"
        figure = geometry_at_angles(stated, mechanics.object, seen=touched, truth_name="stated", title=title)
        return {"geometry_at_angles": figure}

    def save(self, folder: str | Path) -> list[Path]:
        """Write metrics.json and, under figures/, each figure, and the median toss as a film at half its speed.

        Args:
            folder: Made where it is missing.

        Returns:
            The files.
        """
        from tossid.evaluation.figures import save_film, toss_film

        folder = Path(folder)
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        paths = [folder / "metrics.json"]
        paths[0].write_text(json.dumps(self.as_json(), indent=2) + "\n")
        for name, figure in self.figures().items():
            paths.append(folder / "figures" / f"{name}.png")
            figure.savefig(paths[-1])
        median = ranked(self.per_toss.position_error_pct).get("median")
        if median is not None:
            toss = self.dataset.tosses[median]
            film = toss_film(toss, self.rollouts()[median], self.stated, name=self.model.name)
            frame_ms = 10 * max(2, round(400 * float(np.median(np.diff(toss.t)))))
            paths.append(save_film(film, folder / "figures" / "toss_median.gif", frame_ms=frame_ms))
        return paths

    def __repr__(self) -> str:
        lines = [f"Scores of {self.model.name} on {len(self.dataset.tosses)} tosses"]
        known = [(f"  {name}: {mean}", ends) for name, mean, ends, *_ in self.table()[1]]
        lines += [line if ends == "-" else f"{line} ({ends})" for line, ends in known]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        title = f"<p><b>{escape(self.model.name)}</b> on {len(self.dataset.tosses)} tosses</p>"
        return title + html_table(*self.table())


def evaluate(
    model: TrainedModel,
    dataset: Dataset,
    *,
    settings: EvaluateSettings = EvaluateSettings(),
    progress: Progress | None = None,
    **keys: Any,
) -> Scores:
    """How far a model's open-loop rollouts are from the tosses of a dataset.

    Args:
        model: A trained model.
        dataset: Tosses that it was not trained on, such as `dataset.split("test")`; all of them are compared. Its
            object's centre, width and corners are those of the metrics; of a model that learned an unknown object, the
            learned ones.
        settings: How they are compared.
        progress: Called with what is done and the share of the tosses.
        **keys: Settings by name.

    Returns:
        The metrics with intervals over tosses; they show themselves, and `save(folder)` writes them with figures.

    Raises:
        InputError: The dataset has no tosses.
        ConfigError: A key is no setting.
    """
    settings = changed(settings, keys)
    nominal, tosses = stated_object(model, dataset), dataset.tosses
    if not len(tosses):
        raise InputError("there are no tosses to evaluate on")
    predictor, dt = model.model.simulator(), frame_time(tosses)
    how: dict[str, Any] = {"measurement": model.model.measurement, "dt": dt, "n_threads": settings.threads}
    starts, flights, windows = [], [], []
    for first in range(0, len(tosses), settings.batch):
        batch = tosses[first : first + settings.batch]
        starts.append(score_tosses(predictor, nominal, batch, **how))
        if nominal.n_joints == 0:
            flights.append(score_tosses(predictor, nominal, batch, from_flight=True, **how))
        windows.append(score_windows(predictor, nominal, batch, **how))
        if progress is not None:
            done = min(first + settings.batch, len(tosses))
            progress(f"{done} of {len(tosses)} tosses", done / len(tosses))
    scores = joined(starts)
    metrics: dict[str, Any] = summarize_scores(scores, nominal)
    if flights:
        metrics["from_flight"] = summarize_scores(joined(flights), nominal)
    metrics["sixteen_steps"] = summarize_scores(joined(windows), nominal)
    metrics |= {"unsolved": scores.unsolved, "diverged": scores.diverged}
    return Scores(model, dataset, metrics, scores, dt)


def stated_object(model: TrainedModel, dataset: Dataset) -> ObjectModel:
    """The object whose centre, width and corners are those of the metrics.

    It is the dataset's, or the learned one where the model was trained from nothing or the dataset states none.
    """
    return dataset.object if model.settings.object is None and dataset.object.is_stated else model.object


def predicted_motions(
    model: DynamicsModel, nominal: ObjectModel, tosses: Sequence[Toss], *, dt: float | None = None
) -> OnDemand[Rollout]:
    """The motions that `evaluate` scores; those next to the one asked for are rolled out with it, and kept.

    Args:
        model: What is rolled out.
        nominal: The object as it is stated.
        tosses: Give the first states and the numbers of frames.
        dt: Between frames [s]; None for the tosses' median.
    """
    size = EvaluateSettings().batch
    predictor, measurement, dt = model.simulator(), model.measurement, dt or frame_time(tosses)

    def batch(k: int) -> tuple[Rollout, ...]:
        some = tosses[k * size : (k + 1) * size]
        return roll_out(predictor, nominal, some, measurement=measurement, dt=dt)

    batches = OnDemand(batch, -(-len(tosses) // size), kept=1)
    return OnDemand(lambda i: batches[i // size][i % size], len(tosses), kept=0)


def metric_means(metrics: dict[str, Any]) -> dict[str, float]:
    """The means of the metrics of `Scores` and the counts, flat, as a tracker logs them; unknown ones are left out."""
    nested = {"": metrics, **{f"{part}/": metrics.get(part, {}) for part in PARTS}}
    found = {
        f"{prefix}{name}": value["mean"] if isinstance(value, dict) and "mean" in value else value
        for prefix, part in nested.items()
        for name, value in part.items()
    }
    return {name: float(value) for name, value in found.items() if isinstance(value, (int, float))}


def ranked(errors: NDArray[np.float64]) -> dict[str, int]:
    """Indices of the "median" and of the "worst" of the finite errors (B,), where there are any."""
    order = [int(i) for i in np.argsort(errors, kind="stable") if np.isfinite(errors[i])]
    if not order:
        return {}
    worst = {"worst": order[-1]} if len(order) > 1 else {}
    return {"median": order[(len(order) - 1) // 2]} | worst


def _cells(value: dict[str, Any] | None) -> list[str]:
    if value is None:
        return ["-", "-"]
    low, high = value["ci95"]
    few = value.get("n", 2) < 2  # one toss has no spread
    mean, low, high = (number_words(x, 3) for x in (value["mean"], low, high))
    return [mean, "-" if few or low == high else f"{low} to {high}"]
