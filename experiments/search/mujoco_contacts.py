"""How near MuJoCo comes to tosses of Coulomb's exact law, over the numbers of its contact, when all else is true.

    python -m experiments.search.mujoco_contacts

Two cases of `mujoco_models` whose tosses are made by the exact engine and one whose tosses follow MuJoCo are run with
the true effects. Time step, softness (`solref`'s time constant in the least that the step bears) and damping ratio
vary. What is left under the best of them is MuJoCo's law of friction, which lifts what slides (`mujoco_engine`).
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from experiments.search.made_cases import made
from experiments.search.mujoco_models import MODEL, TOSSES, drawn
from tossid.diagnosis.inference.hypothesis import COULOMB, Hypothesis
from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.rollouts import at_frames, distances, first_states, toss_errors
from tossid.diagnosis.patch.make import make_patch
from tossid.diagnosis.simulators import read_simulator
from tossid.motion.resting import rest_scatter
from tossid.objects import load_object
from tossid.physics.effects import effects_for

CASES = (0, 1, 4)
STEPS, SOFTNESS, DAMPING = (1e-4, 2e-5), (1, 3, 10), (10.0, 100.0)


def compared(case: int) -> None:
    """Print mean errors of whole tosses of a case, by contact.

    Args:
        case: Its number.
    """
    engine, truth = drawn(case)
    dataset = made(load_object("cube"), engine, truth, TOSSES, case)
    tosses, model = dataset.tosses, dataset.object
    windows = make_windows(tosses, model, scatter=rest_scatter(tosses, model))
    library = {effect.name: effect for effect in effects_for(model)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "cube.xml"
        path.write_text(MODEL)
        true = Hypothesis(read_simulator(path, model).world, COULOMB)
        for name, values in truth.items():
            true = true.plus(library[name], library[name].values_with(true.world(), values))
        patched = make_patch(true, mjcf=path).model
    world = true.world()
    first = first_states(tosses, world, windows, n_threads=1)
    level = replace(world, ground_height=0.0, ground_tilt=(0.0, 0.0))  # the model has its own ground

    def errors(scene: mujoco.MjModel) -> str:
        motions = at_frames(tosses, first, windows.dt, MujocoWorld(scene, level).roll_out)
        return "{:.2f} % {:.2f} deg".format(*np.nanmean(distances(motions, [t.q for t in tosses], model.width), axis=0))

    exact = np.nanmean(toss_errors(tosses, world, windows, n_threads=1), axis=0)
    print(f"case {case}, tosses by {engine}: exact engine {exact[0]:.2f} % {exact[1]:.2f} deg, patch {errors(patched)}")
    for step, soft, damping in itertools.product(STEPS, SOFTNESS, DAMPING):
        scene = copy.copy(patched)
        scene.opt.timestep = step
        scene.geom_solref[:] = [2 * step * soft, damping]
        print(f"    step {step:g} s, time constant {2 * soft} steps, damping ratio {damping:g}: {errors(scene)}")


if __name__ == "__main__":
    for number in CASES:
        compared(number)
