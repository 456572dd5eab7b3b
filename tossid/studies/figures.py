"""The figures of a study: which are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from tossid.objects import GRAVITY
from tossid.studies.tables import Row, measured_penetration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tossid.models import TrainedModel
    from tossid.store import Dataset


def study_figures(
    swept: str, cells: Sequence[Row], held_out: Dataset, *, model_of: Callable[[Row], TrainedModel]
) -> dict[str, Figure]:
    """Figures of a study by name: its metrics over the swept value, from the first state and from the flight.

    A study of gravity also has what k_res repairs, in the cell that was given the most wrong gravity. A study of
    something else than gravity, tosses and inertia has no figures.

    Args:
        swept: The name of the swept value in a cell.
        cells: Of the study.
        held_out: The tosses that they were evaluated on.
        model_of: Gives the trained model of a cell.
    """
    from tossid.evaluation.figures import data_efficiency, gravity_sweep, inertia_study

    if swept == "start_inertia":
        return {"inertia_study": inertia_study(cells)}
    starts = {"": False} | ({"_from_flight": True} if all("from_flight" in cell for cell in cells) else {})
    if swept == "tosses":
        return {
            f"data_efficiency{suffix}": data_efficiency(cells, swept=swept, from_flight=from_flight)
            for suffix, from_flight in starts.items()
        }
    if swept != "gravity":
        return {}
    depth = measured_penetration(held_out.tosses, held_out.object)
    figures = {
        f"gravity_sweep{suffix}": gravity_sweep(cells, measured_penetration_mm=depth, from_flight=from_flight)
        for suffix, from_flight in starts.items()
    }
    return figures | _accelerations_at_worst_gravity(cells, held_out, model_of)


def _accelerations_at_worst_gravity(
    cells: Sequence[Row], held_out: Dataset, model_of: Callable[[Row], TrainedModel]
) -> dict[str, Figure]:
    """What k_res repairs, of the cell with a k_res that was given the most wrong gravity."""
    from tossid.evaluation.evaluate import evaluate
    from tossid.evaluation.score_figures import acceleration_figure

    for cell in sorted(cells, key=lambda cell: -abs(cell["gravity"] - GRAVITY)):
        model = model_of(cell)
        if model.settings.model.learn_k_res:
            return acceleration_figure(evaluate(model, held_out))
    return {}
