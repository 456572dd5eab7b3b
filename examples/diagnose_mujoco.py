"""Your own simulator, diagnosed: a cube in MuJoCo, with MuJoCo's default soft contact.

From Python, any function f(q0, v0, n_steps, dt) -> (q, v) over a batch serves, as below. On the command line:

    tossid diagnose data=FILE.h5 sim=python sim.path=examples/diagnose_mujoco.py sim.function=simulate
"""

import math
import sys
from functools import lru_cache

import mujoco
import numpy as np

STEP = 1e-3
MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -{gravity}"/>
  <worldbody>
    <geom type="plane" size="5 5 1" friction="{mu} 0 0"/>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="0.37" diaginertia="0.00081 0.00081 0.00081"/>
      <geom type="box" size="0.0524 0.0524 0.0524" friction="{mu} 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


@lru_cache
def compiled(mu, gravity):
    """The model, compiled once: a diagnosis calls `simulate` for single frames."""
    return mujoco.MjModel.from_xml_string(MODEL.format(mu=mu, gravity=gravity, step=STEP))


def simulate(q0, v0, n_steps, dt, mu=0.18, gravity=9.81):
    """Motions of a batch of cubes, as MuJoCo has them.

    q0 (B, 7): position [m], quaternion wxyz. v0 (B, 6): linear in the world, angular in the body frame: MuJoCo's own.
    Returns q (B, n_steps + 1, 7) and v (B, n_steps + 1, 6), first states included.
    """
    model = compiled(mu, gravity)
    substeps = math.ceil(dt / STEP)
    model.opt.timestep = dt / substeps
    data = mujoco.MjData(model)
    q, v = np.empty((len(q0), n_steps + 1, 7)), np.empty((len(q0), n_steps + 1, 6))
    for row in range(len(q0)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = q0[row], v0[row]
        q[row, 0], v[row, 0] = q0[row], v0[row]
        for frame in range(1, n_steps + 1):
            mujoco.mj_step(model, data, substeps)
            q[row, frame], v[row, frame] = data.qpos, data.qvel
    return q, v


if __name__ == "__main__":
    import tossid
    from tossid.settings.synthesis import NoiseSettings

    few = "--quick" in sys.argv
    # in place of your recording: twelve tosses of a cube whose friction is 0.3
    noise = NoiseSettings(position=1e-4, rotation=1e-3, velocity=0.02, spin=0.2)
    dataset = tossid.synthesize("cube", tosses=12, engine="mujoco", effects={"friction": {"mu": 0.3}}, noise=noise)
    effects = [effect.name for effect in tossid.physics.effects.LIBRARY]
    without = tuple(name for name in effects if few and name not in ("friction", "gravity", "com_offset"))
    gap = tossid.diagnose(dataset, simulator=simulate, without=without, repeats=0 if few else 4)
    print(gap)
    gap.save("gap-mujoco")
