"""Drake, diagnosed: a cube with compliant point contact at its corners (`pip install drake`).

tossid diagnose data=FILE.h5 sim=python sim.path=examples/diagnose_drake.py sim.function=simulate
"""

import itertools
import sys
from functools import lru_cache

import numpy as np
from pydrake.all import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiagramBuilder,
    DiscreteContactApproximation,
    HalfSpace,
    RigidTransform,
    Simulator,
    SpatialInertia,
    Sphere,
    UnitInertia,
)

HALF, MASS, INERTIA, GRAVITY, RADIUS = 0.0524, 0.37, 0.00081, 9.81, 1e-3


@lru_cache  # built once: a diagnosis calls `simulate` for single frames
def _diagram(mu, step):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=step)
    moment = INERTIA / MASS
    body = plant.AddRigidBody("cube", SpatialInertia(MASS, np.zeros(3), UnitInertia(moment, moment, moment)))
    friction = CoulombFriction(mu, mu)
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        place = RigidTransform((HALF - RADIUS) * np.array(corner))
        plant.RegisterCollisionGeometry(body, place, Sphere(RADIUS), f"corner {corner}", friction)
    plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), HalfSpace(), "ground", friction)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
    # Drake's default, lagged, stops a slide after a third of its way at some lengths of a step
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
    plant.Finalize()
    return builder.Build(), plant


def _rotation(quaternion):
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def simulate(q0, v0, n_steps, dt, mu=0.18):
    """Motions of a batch of cubes; Drake has quaternions before positions, and spin, in the world, before velocity."""
    diagram, plant = _diagram(mu, dt / 8)
    q, v = np.empty((len(q0), n_steps + 1, 7)), np.empty((len(q0), n_steps + 1, 6))
    for row in range(len(q0)):
        simulator = Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetPositions(context, np.concatenate([q0[row, 3:7], q0[row, :3]]))
        plant.SetVelocities(context, np.concatenate([_rotation(q0[row, 3:7]) @ v0[row, 3:], v0[row, :3]]))
        simulator.Initialize()
        q[row, 0], v[row, 0] = q0[row], v0[row]
        for frame in range(1, n_steps + 1):
            simulator.AdvanceTo(frame * dt)
            there, moving = plant.GetPositions(context), plant.GetVelocities(context)
            q[row, frame] = np.concatenate([there[4:], there[:4] / np.linalg.norm(there[:4])])
            v[row, frame] = np.concatenate([moving[3:], _rotation(there[:4]).T @ moving[:3]])
    return q, v


if __name__ == "__main__":
    import tossid

    tossid.diagnose(tossid.read_dataset(sys.argv[1]), simulator=simulate).save("gap-drake")
