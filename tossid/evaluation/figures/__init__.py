"""Figures of training and evaluation: pure functions from arrays and frozen types to `matplotlib.figure.Figure`.

They know no files and no tracker, use no pyplot, and leave matplotlib's settings
as they were. `figure.savefig(path)` writes them at 150 dpi.
"""

from tossid.evaluation.figures.films import hull_film, save_film, toss_film
from tossid.evaluation.figures.geometry import geometry_at_angles, learned_geometry
from tossid.evaluation.figures.studies import data_efficiency, gravity_sweep, inertia_study
from tossid.evaluation.figures.toss import residual_over_toss, toss_comparison
from tossid.evaluation.figures.tosses import (
    ErrorsAlong,
    errors_along,
    errors_along_rollout,
    errors_over_tosses,
    recording_over_order,
)
from tossid.evaluation.figures.training import training_curves

__all__ = [
    # one run
    "training_curves",
    "learned_geometry",
    "geometry_at_angles",
    "toss_comparison",
    "residual_over_toss",
    # films
    "toss_film",
    "hull_film",
    "save_film",
    # many tosses
    "errors_over_tosses",
    "errors_along",
    "ErrorsAlong",
    "errors_along_rollout",
    "recording_over_order",
    # studies
    "gravity_sweep",
    "data_efficiency",
    "inertia_study",
]
