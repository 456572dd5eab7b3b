"""Figures of training and evaluation: pure functions from arrays and frozen types to `matplotlib.figure.Figure`.

They know no files and no tracker, use no pyplot, and leave matplotlib's settings
as they were. `figure.savefig(path)` writes them at 150 dpi.
"""

from tossid.evaluation.figures.accelerations import Accelerations, accelerations_over_toss
from tossid.evaluation.figures.angles import geometry_at_angles
from tossid.evaluation.figures.comparison import toss_comparison
from tossid.evaluation.figures.errors import ErrorsAlong, errors_along, errors_along_rollout, errors_over_tosses
from tossid.evaluation.figures.film import save_film, toss_film
from tossid.evaluation.figures.geometry import learned_geometry
from tossid.evaluation.figures.hull_film import hull_film
from tossid.evaluation.figures.inertia import inertia_study
from tossid.evaluation.figures.residual import residual_over_toss
from tossid.evaluation.figures.sessions import recording_over_order
from tossid.evaluation.figures.sizes import costs_of_size
from tossid.evaluation.figures.studies import data_efficiency, gravity_sweep
from tossid.evaluation.figures.training import training_curves

__all__ = [
    # one run
    "training_curves",
    "learned_geometry",
    "geometry_at_angles",
    "toss_comparison",
    "toss_film",
    "hull_film",
    "save_film",
    "residual_over_toss",
    "accelerations_over_toss",
    "Accelerations",
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
    # sizes
    "costs_of_size",
]
