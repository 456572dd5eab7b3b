"""`make demo`: a simulator that is wrong in a way that is drawn and sealed, what is found of it, and a learned model.

MuJoCo tosses a tagged cube that differs in one way from the cube of the simulator's file. The difference is drawn at
random, and only its hash is printed. Three cameras film the tosses. From the frames alone come poses, tosses and a
diagnosis of the file. Then the seal is opened, and the truth stands beside what was found. Last, a model is learned
from the tosses alone, without the file.
"""

from __future__ import annotations

import argparse
import secrets
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.call import call_with_keys, logged
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from pipelines.demo_page import DATASET, FOLDER, RECORDING, write_page
from pipelines.seal import Opened, Sealed, judgement
from tossid.objects import GRAVITY, load_object
from tossid.settings.synthesis import CameraSettings, MujocoEngine, SynthesizeSettings

if TYPE_CHECKING:
    from tossid.types import Progress

WORLD = SynthesizeSettings(
    # 17 steps a frame: contact is near rigid, and a person can still run cube.xml at once
    engine=MujocoEngine(substeps=17),
    tosses=14,
    # half the images of the default cameras, of half the size: poses stay within a few hundredths of a millimetre
    camera=CameraSettings(width=480, height=384, samples=4, carry_s=(0.2, 0.25), pause_s=(0.15, 0.15)),
)
"""How the cube is tossed and filmed."""
MASS = 0.37
"""Of the cube [kg]: all that the learned model is given."""


def command(console: Console, name: str, *keys: str) -> dict[str, Any]:
    """Run a command of tossid as a person would; returns what it says with --json."""
    console.say(f"\n$ tossid {name} {' '.join(keys)}".rstrip())
    return dict(call_with_keys(name, keys, json=False, quiet=False))


def main() -> None:
    """Seal, toss and film; ingest, diagnose, open the seal; learn from nothing and evaluate; write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="of what is wrong and of the throws; a new one each time without it")
    seed = parser.parse_args().seed
    seed = secrets.randbelow(10**6) if seed is None else seed
    console, sealed = Console(), Sealed.drawn(seed)
    simulator = stated_simulator(FOLDER / "cube.xml")
    console.say(f"Something is wrong with {simulator}. What it is is sealed: SHA-256 {sealed.sha256}")

    console.say(
        f"\nA cube unlike that of {simulator} is tossed {WORLD.tosses} times in MuJoCo, and filmed (seed {seed})."
    )
    with logged(console), console.shares("tossing and filming") as progress:
        film(sealed, seed, RECORDING, progress=lambda _, share: progress("", share))
    # a shape needs every toss that it can get: most are trained on
    read = ("source=frames", f"source.path={RECORDING}", "object=cube", "splits=[0.7,0.15,0.15]")
    command(console, "ingest", *read, f"out={DATASET}")
    gap = command(console, "diagnose", f"data={DATASET}", "sim=mjcf", f"sim.path={simulator}", f"out={FOLDER / 'gap'}")
    seal = Opened.of(sealed, gap)
    console.say(f"\nThe seal is opened: {sealed.text}")
    console.table(["", "in cube.xml", "sealed truth", "found (95 %)"], [seal.row])
    console.say(judgement(seal))

    keys = ("model=cnrpi", f"data={DATASET}", "object=unknown", f"object.mass={MASS}")
    trained = command(console, "train", *keys)
    scores = command(console, "evaluate")
    console.say(f"Open {write_page(seal, gap, trained, scores)}")


def film(sealed: Sealed, seed: int, recording: Path, *, progress: Progress | None = None) -> None:
    """Toss the cube that has the sealed difference in MuJoCo, and film it. The frames do not say what it is.

    Args:
        sealed: The difference.
        seed: Of the throws and of the cameras' noise.
        recording: A folder that is written.
        progress: Called with the share that is done.
    """
    import tossid

    effects = {sealed.effect: {sealed.parameter: sealed.value}}
    how: dict[str, Any] = {"settings": WORLD, "seed": seed, "effects": effects, "progress": progress}
    tossid.synthesize("cube", frames=True, out=recording, **how)


def stated_simulator(path: Path) -> Path:
    """Write the simulator that is wrong: the stated cube on a plane, in the engine that tosses the real one.

    Args:
        path: The file.
    """
    from tossid.physics.effects.in_mujoco import scene_text

    path.parent.mkdir(parents=True, exist_ok=True)
    assert isinstance(WORLD.engine, MujocoEngine)
    assert WORLD.engine.substeps is not None
    step = 1 / (WORLD.rate_hz * WORLD.engine.substeps)
    path.write_text(scene_text(load_object("cube"), gravity=GRAVITY, step=step), encoding="utf-8")
    return path


if __name__ == "__main__":
    sys.exit(guarded(main, "demo"))
