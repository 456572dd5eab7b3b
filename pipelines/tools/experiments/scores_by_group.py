"""Short rollouts of trained models by session, place, resting face and release: where what is left lies.

python -m pipelines.tools.experiments.scores_by_group DATASET.h5 MODEL [MODEL …]

A model is a checkpoint (.pt), or `nominal` for the simulator of the object as the dataset states it. Held-out tosses
only (split "test"); 16 steps, as `tossid evaluate` scores them. Of groups, p is that of the test of Kruskal and Wallis.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.errors import InputError


def main(data: Path, models: list[str]) -> None:
    """Say the scores of each model by group."""
    from tossid import TrainedModel, read_dataset
    from tossid.evaluation.evaluate import stated_object
    from tossid.evaluation.groups import compare_groups, toss_groups
    from tossid.evaluation.metrics import score_windows
    from tossid.models.predictor import Predictor, Simulator
    from tossid.motion import MeasurementModel
    from tossid.physics import make_system
    from tossid.types import frame_time

    if not models:
        raise InputError("name a dataset, and the checkpoints of models that were trained on it, or 'nominal'")
    console, dataset = Console(), read_dataset(data).split("test")
    groups = toss_groups(dataset)
    predictor: Predictor
    measurement: MeasurementModel | None
    for name in models:
        if name == "nominal":
            predictor, stated, measurement = Simulator(make_system(dataset.object)), dataset.object, None
        else:
            trained = TrainedModel.load(Path(name))
            predictor, measurement = trained.model.simulator(), trained.model.measurement
            stated = stated_object(trained, dataset)
        scores = score_windows(
            predictor, stated, dataset.tosses, measurement=measurement, dt=frame_time(dataset.tosses)
        )
        columns = {"position [%]": scores.position_error_pct}
        columns |= {f"{link} [deg]": scores.link_error_deg[:, b] for b, link in enumerate(stated.body_names)}
        if stated.n_joints:
            columns["joint [deg]"] = scores.joint_error_deg
        rows = []
        whole = {"all": ("all",) * len(dataset)}
        for grouping, labels in {**whole, **groups}.items():
            found = {column: compare_groups(values, labels) for column, values in columns.items()}
            first = next(iter(found.values()))
            for i, group in enumerate(first.groups):
                cells = [one.groups[i] for one in found.values()]
                texts = [f"{cell.mean:.2f} ({cell.ci95[0]:.2f} to {cell.ci95[1]:.2f})" for cell in cells]
                rows.append([grouping if i == 0 else "", group.name, str(group.n), *texts])
            if len(first.groups) > 1:
                p = [f"p {one.p:.2g}" if np.isfinite(one.p) else "" for one in found.values()]
                rows.append(["", "(as different by chance)", "", *p])
        console.table(
            ("by", "group", "tosses", *columns), rows, title=f"{name}: 16 steps, {len(dataset)} tosses of {data}"
        )


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1]), sys.argv[2:]), "scores_by_group"))
