"""Physics: dynamics of a tree, contact problems and their solvers, time stepping."""

from tossid.physics.batch import TreeBatch, tree_batch
from tossid.physics.network import (
    N_WORLD,
    LearnedAcceleration,
    learned_accelerations,
    n_features,
    no_learned_acceleration,
)
from tossid.physics.registered_forces import register_force
from tossid.physics.solvers import ExactCone, PolyhedralCone, register_solver
from tossid.physics.stepping import Simulation, simulate
from tossid.physics.system import System, make_system

__all__ = [
    "N_WORLD",
    "ExactCone",
    "LearnedAcceleration",
    "PolyhedralCone",
    "Simulation",
    "System",
    "TreeBatch",
    "learned_accelerations",
    "make_system",
    "n_features",
    "no_learned_acceleration",
    "register_force",
    "register_solver",
    "simulate",
    "tree_batch",
]
