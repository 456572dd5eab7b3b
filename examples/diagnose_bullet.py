"""Bullet, diagnosed: a cube on a plane (`pip install pybullet`).

tossid diagnose data=FILE.h5 sim=python sim.path=examples/diagnose_bullet.py sim.function=simulate
"""

import sys
from functools import lru_cache

import numpy as np
import pybullet

HALF, MASS, INERTIA, GRAVITY, SUBSTEPS = 0.0524, 0.37, 0.00081, 9.81, 8


def _turned(quaternion, vector):
    """A vector in the body frame, in the world (Bullet's quaternions are xyzw)."""
    return np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3) @ vector


@lru_cache  # connected once: a diagnosis calls `simulate` some thirty thousand times, mostly for single frames
def _cube(mu):
    """A cube above the ground, in a server of its own: the cube's number, and which server."""
    server = {"physicsClientId": pybullet.connect(pybullet.DIRECT)}
    pybullet.setGravity(0.0, 0.0, -GRAVITY, **server)
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, **server)
    box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[HALF] * 3, **server)
    ground, cube = pybullet.createMultiBody(0.0, plane, **server), pybullet.createMultiBody(MASS, box, **server)
    pybullet.changeDynamics(ground, -1, lateralFriction=1.0, restitution=0.0, **server)
    pybullet.changeDynamics(
        cube,
        -1,
        lateralFriction=mu,
        restitution=0.0,
        localInertiaDiagonal=[INERTIA] * 3,
        linearDamping=0.0,
        angularDamping=0.0,
        **server,
    )
    return cube, server


def simulate(q0, v0, n_steps, dt, mu=0.18):
    """Motions of a batch of cubes; Bullet multiplies two bodies' friction, and its spin is in the world."""
    cube, server = _cube(mu)
    pybullet.setTimeStep(dt / SUBSTEPS, **server)
    q, v = np.empty((len(q0), n_steps + 1, 7)), np.empty((len(q0), n_steps + 1, 6))
    for row in range(len(q0)):
        turn = np.roll(q0[row, 3:7], -1)
        # Bullet keeps points of contact from step to step; those of the motion before are lost high above the ground
        pybullet.resetBasePositionAndOrientation(cube, [0.0, 0.0, 1e3], turn, **server)
        pybullet.performCollisionDetection(**server)
        pybullet.resetBasePositionAndOrientation(cube, q0[row, :3], turn, **server)
        pybullet.resetBaseVelocity(cube, v0[row, :3], _turned(turn, v0[row, 3:]), **server)
        q[row, 0], v[row, 0] = q0[row], v0[row]
        for frame in range(1, n_steps + 1):
            for _ in range(SUBSTEPS):
                pybullet.stepSimulation(**server)
            place, turn = pybullet.getBasePositionAndOrientation(cube, **server)
            velocity, spin = pybullet.getBaseVelocity(cube, **server)
            inverse = pybullet.invertTransform([0, 0, 0], turn)[1]
            q[row, frame] = np.concatenate([place, np.roll(turn, 1)])
            v[row, frame] = np.concatenate([velocity, _turned(inverse, np.array(spin))])
    return q, v


if __name__ == "__main__":
    import tossid

    tossid.diagnose(tossid.read_dataset(sys.argv[1]), simulator=simulate).save("gap-bullet")
