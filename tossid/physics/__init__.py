"""Physics: dynamics of a tree, contact problems and their solvers, time stepping."""

from tossid.physics.batch import TreeBatch, tree_batch
from tossid.physics.stepping import Simulation, simulate
from tossid.physics.system import Residual, System, make_system, n_features, no_residual

__all__ = [
    "Residual",
    "Simulation",
    "System",
    "TreeBatch",
    "make_system",
    "n_features",
    "no_residual",
    "simulate",
    "tree_batch",
]
