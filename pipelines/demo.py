"""`make demo`: a simulator that is wrong in a way that is drawn and sealed, what is found of it, and a learned model.

MuJoCo tosses a tagged cube that differs in one way from the cube of the simulator's file. The difference is drawn at
random, and only its hash is printed. Three cameras film the tosses. From the frames alone come poses, tosses and a
diagnosis of the file. Then the seal is opened, and the truth stands beside what was found.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import secrets
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.cli.call import call_with_keys, logged
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded

if TYPE_CHECKING:
    from tossid.store import Dataset

RECORDING = Path("data/raw/demo")
DATASET = Path("data/datasets/demo.h5")
FOLDER = Path("outputs/demo")
TOSSES = 14
FRAMES_SHOWN = 6
"""Of a toss, on the page."""
KINDS: dict[str, tuple[str, tuple[tuple[float, float], ...]]] = {
    "friction": ("mu", ((0.26, 0.40),)),
    "com_offset": ("z_m", ((-0.006, -0.003), (0.003, 0.006))),
    "inertia": ("scale_rel", ((1.2, 1.5),)),
    "gravity": ("g_ms2", ((9.2, 9.55), (10.1, 10.4))),
}
"""What may be wrong: by effect, its parameter and the ranges in one of which its true value lies."""


@dataclass(frozen=True)
class Sealed:
    """What is wrong with the simulator, and the salt that keeps its hash from being guessed."""

    effect: str
    parameter: str
    value: float
    salt: str

    @staticmethod
    def drawn(seed: int) -> Sealed:
        """A difference drawn at random.

        Args:
            seed: Of the draw.
        """
        rng = np.random.default_rng([seed, 41])
        effect = str(rng.choice(list(KINDS)))
        parameter, ranges = KINDS[effect]
        low, high = ranges[rng.integers(len(ranges))]
        return Sealed(effect, parameter, round(float(rng.uniform(low, high)), 4), rng.bytes(8).hex())

    @property
    def text(self) -> str:
        """What is hashed."""
        return json.dumps(vars(self), sort_keys=True)

    @property
    def sha256(self) -> str:
        """Its hash, which is printed before anything else."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def main() -> None:
    """Seal, toss and film; ingest, diagnose, open the seal; train and evaluate; write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="of what is wrong and of the throws; a new one each time without it")
    seed = parser.parse_args().seed
    seed = secrets.randbelow(10**6) if seed is None else seed
    console, started = Console(), time.perf_counter()
    sealed = Sealed.drawn(seed)
    console.say(f"Something is wrong with outputs/demo/cube.xml. Sealed, SHA-256 {sealed.sha256}")
    filmed(sealed, seed, console)
    simulator = stated_simulator()

    def step(command: str, *keys: str) -> dict[str, Any]:
        console.say(f"\n$ tossid {command} {' '.join(keys)}".rstrip())
        result: dict[str, Any] = call_with_keys(command, keys, json=False, quiet=False)
        return result

    step("ingest", "source=frames", f"source.path={RECORDING}", "object=cube", f"out={DATASET}")
    gap = step("diagnose", f"data={DATASET}", "sim=mjcf", f"sim.path={simulator}", f"out={FOLDER / 'gap'}")
    seal = opened(sealed, gap)
    console.table(["", "in cube.xml", "sealed truth", "found (95 %)"], [seal], title=f"The seal: {sealed.text}")
    trained = step("train", "model=cnrpi", f"data={DATASET}")
    scores = step("evaluate")
    poses = pose_rows()
    console.table(["quantity", "value"], poses)
    page = write_page(sealed, seal, gap, [*trained["figures"], *scores["figures"]], poses)
    console.say(f"{time.perf_counter() - started:.0f} s. Open {page}")


def filmed(sealed: Sealed, seed: int, console: Console) -> None:
    """Toss the cube that has the sealed difference in MuJoCo, and film it. The frames do not say what it is."""
    import tossid

    keys = f"object=cube engine=mujoco tosses={TOSSES} seed={seed} frames=true effects=SEALED out={RECORDING}"
    console.say(f"\n$ tossid synthesize {keys}")
    with logged(console), console.shares("tossing and filming") as progress:
        tossid.synthesize(
            "cube",
            frames=True,
            out=RECORDING,
            engine="mujoco",
            tosses=TOSSES,
            seed=seed,
            effects={sealed.effect: {sealed.parameter: sealed.value}},
            progress=lambda _, share: progress("tossing and filming", share),
        )


def stated_simulator() -> Path:
    """The file of the simulator that is wrong: the stated cube on a plane, with rigid contact."""
    from tossid.objects import load_object
    from tossid.objects.mjcf import to_mjcf

    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / "cube.xml"
    path.write_text(to_mjcf(load_object("cube")), encoding="utf-8")
    return path


def opened(sealed: Sealed, gap: dict[str, Any]) -> list[str]:
    """A row: the sealed effect, its stated value, its true one, and what was found of it.

    Args:
        sealed: What is wrong.
        gap: Of `tossid diagnose`.
    """
    name = f"{sealed.effect} {sealed.parameter}"
    for effect in gap["effects"]:
        known = effect["parameters"].get(sealed.parameter)
        if effect["name"] == sealed.effect and known is not None:
            low, high = known["ci95"]
            found = f"{known['value']:.4g} ({low:.4g} to {high:.4g}), {effect['verdict']}"
            return [name, f"{effect['stated'][sealed.parameter]:.4g}", f"{sealed.value:.4g}", found]
    others = ", ".join(gap["explanation"]["effects"]) or "nothing"
    return [name, "", f"{sealed.value:.4g}", f"not found; {others} instead"]


def pose_rows() -> list[list[str]]:
    """How many tosses were found, and how far their poses are from the truth."""
    from tossid.store import read_dataset

    truth, seen = read_dataset(RECORDING / "truth.h5"), read_dataset(DATASET)
    distance, turn = pose_errors(truth, seen)
    return [
        ["tosses found", f"{len(seen.tosses)} of {len(truth.tosses)}"],
        ["pose error, median", f"{np.median(distance):.3f} mm, {np.median(turn):.3f} deg"],
        ["pose error, worst", f"{distance.max():.2f} mm, {turn.max():.2f} deg"],
    ]


def pose_errors(truth: Dataset, seen: Dataset) -> tuple[Any, Any]:
    """Distance [mm] and angle [deg] between seen and true poses, in every frame of a seen toss that the truth has."""
    from tossid.rotations import geodesic_angle

    distance, angle = [], []
    for toss in seen.tosses:
        for true in truth.tosses:
            row = np.round((toss.t - true.t[0]) * truth.rate_hz).astype(int)
            inside = (row >= 0) & (row < len(true))
            distance.append(1e3 * np.linalg.norm(toss.q[inside, :3] - true.q[row[inside], :3], axis=1))
            angle.append(np.rad2deg(geodesic_angle(toss.q[inside, 3:7], true.q[row[inside], 3:7])))
    return np.concatenate(distance), np.concatenate(angle)


# ---------------------------------------------------------------- the page


def write_page(
    sealed: Sealed, seal: list[str], gap: dict[str, Any], figures: list[str], poses: list[list[str]]
) -> Path:
    """Write outputs/demo/index.html, with the pictures beside it.

    Args:
        sealed: What was wrong.
        seal: The row of `opened`.
        gap: Of `tossid diagnose`.
        figures: Pictures of the training and of the evaluation.
        poses: Rows of `pose_rows`.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pictures = FOLDER / "pictures"
    pictures.mkdir(exist_ok=True)
    page = Environment(loader=PackageLoader("pipelines", "pages"), autoescape=True, undefined=StrictUndefined)
    page.filters["picture"] = lambda path: _copied(Path(path), pictures)
    text = page.get_template("demo.html.j2").render(
        sealed=sealed,
        seal=seal,
        gap=gap,
        film=[_copied(frame, pictures) for frame in film_strip()],
        gap_figures=gap["figures"],
        figures=[path for path in figures if Path(path).suffix in (".png", ".gif")],
        poses=poses,
        dataset=DATASET,
        simulator=FOLDER / "cube.xml",
    )
    out = FOLDER / "index.html"
    out.write_text(text, encoding="utf-8")
    return out


def film_strip() -> list[Path]:
    """Frames of the first toss as the first camera saw it, from release to rest."""
    from tossid.store import read_dataset
    from tossid.vision.recordings.formats.frames import read_recording

    recording, toss = read_recording(RECORDING), read_dataset(RECORDING / "truth.h5").tosses[0]
    frames = recording.frames[recording.cameras[0].name]
    inside = [f for f in frames if toss.t[0] <= 1e-9 * f.t_ns <= toss.t[-1]]
    return [inside[k].path for k in np.linspace(0, len(inside) - 1, FRAMES_SHOWN).round().astype(int)]


def _copied(path: Path, folder: Path) -> str:
    """The address, from the page, of a copy of a picture."""
    name = f"{path.parent.parent.name}-{path.name}"
    shutil.copyfile(path, folder / name)
    return f"{folder.name}/{name}"


if __name__ == "__main__":
    sys.exit(guarded(main, "demo"))
