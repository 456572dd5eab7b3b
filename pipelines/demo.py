"""`make demo`: a simulator that is wrong in a way that is drawn and sealed, what is found of it, and a learned model.

MuJoCo tosses a tagged cube that differs in one way from the cube of the simulator's file. The difference is drawn at
random, and only its hash is printed. Three cameras film the tosses. From the frames alone come poses, tosses and a
diagnosis of the file. Then the seal is opened, and the truth stands beside what was found. Last, a model is learned
from the tosses alone, without the file.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import secrets
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipelines.cli.call import call_with_keys, logged
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.objects import GRAVITY, ObjectModel, load_object
from tossid.physics.effects import World, effect_named
from tossid.settings.synthesis import CameraSettings, MujocoEngine, SynthesizeSettings

if TYPE_CHECKING:
    from tossid.models import TrainedModel
    from tossid.store import Dataset
    from tossid.types import Progress, Rollout, Toss

RECORDING = Path("data/raw/demo")
DATASET = Path("data/datasets/demo.h5")
FOLDER = Path("outputs/demo")
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
WITHIN = 0.1
"""Share of the true change by which the found one may be off: a demo succeeds where it names the effect, no other, and
comes so near."""


class Kind(NamedTuple):
    """An effect that may be wrong, its parameter, that one's value in cube.xml, and ranges in which the truth lies."""

    parameter: str
    stated: float
    ranges: tuple[tuple[float, float], ...]


KINDS = {
    "friction": Kind("mu", 0.18, ((0.26, 0.40),)),
    "com_offset": Kind("z_m", 0.0, ((-0.006, -0.003), (0.003, 0.006))),
    "inertia": Kind("scale_rel", 1.0, ((1.2, 1.5),)),
    "gravity": Kind("g_ms2", GRAVITY, ((9.2, 9.55), (10.1, 10.4))),
}
"""What may be wrong, by the effect's name."""


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
        parameter, _, ranges = KINDS[effect]
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


@dataclass(frozen=True)
class Opened:
    """A seal beside what was found.

    Attributes:
        sealed: The truth.
        named: The effects that were named, in the order in which they matter.
        value: Of the sealed parameter, as found; None where its effect was not named.
        ci95: Its 95 % interval.
    """

    sealed: Sealed
    named: tuple[str, ...]
    value: float | None = None
    ci95: tuple[float, float] = (np.nan, np.nan)

    @staticmethod
    def of(sealed: Sealed, gap: Mapping[str, Any]) -> Opened:
        """The seal opened.

        Args:
            sealed: What is wrong.
            gap: The content of gap.json.
        """
        named = tuple(gap["explanation"]["effects"])
        for effect in gap["effects"]:
            known = effect["parameters"].get(sealed.parameter)
            if effect["name"] == sealed.effect and sealed.effect in named and known is not None:
                return Opened(sealed, named, known["value"], tuple(known["ci95"]))
        return Opened(sealed, named)

    @property
    def right(self) -> bool:
        """Whether the sealed effect was named, no other, and its change is right to within `WITHIN` of it."""
        if self.value is None or self.named != (self.sealed.effect,):
            return False
        change = self.sealed.value - KINDS[self.sealed.effect].stated
        return abs(self.value - self.sealed.value) <= WITHIN * abs(change)

    @property
    def row(self) -> list[str]:
        """The sealed effect, its value in cube.xml, its true one, and what was found, as a person reads them."""
        from tossid.diagnosis.findings import Interval
        from tossid.diagnosis.report.units import in_units, parameter, quantity

        key, kind = self.sealed.parameter, KINDS[self.sealed.effect]
        head = f"{self.sealed.effect} {parameter(key)}"
        if self.value is None:
            found = f"not named; {', '.join(self.named) or 'nothing'} instead"
        else:
            found = in_units(key, Interval(self.value, *self.ci95))
            others = [name for name in self.named if name != self.sealed.effect]
            found += f"; besides {', '.join(others)}" if others else ""
        return [head, quantity(key, kind.stated), quantity(key, self.sealed.value), found]


@dataclass
class Steps:
    """What each step takes.

    Attributes:
        console: What a person sees.
        rows: Name, elapsed seconds, and seconds of processor time, of this process and those that it started.
    """

    console: Console
    rows: list[tuple[str, float, float]] = field(default_factory=list)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Say how long the block takes, and keep it.

        Args:
            name: What it does.
        """
        elapsed, processor = time.perf_counter(), processor_seconds()
        yield
        self.rows.append((name, time.perf_counter() - elapsed, processor_seconds() - processor))
        self.console.say(f"-- {name}: {self.rows[-1][1]:.0f} s, {self.rows[-1][2]:.0f} s of processor time")

    def command(self, name: str, *keys: str) -> dict[str, Any]:
        """Run a command of tossid as a person would, timed; returns what it says with --json."""
        self.console.say(f"\n$ tossid {name} {' '.join(keys)}".rstrip())
        with self.timed(name):
            result: dict[str, Any] = call_with_keys(name, keys, json=False, quiet=False)
        return result


def processor_seconds() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> None:
    """Seal, toss and film; ingest, diagnose, open the seal; learn from nothing and evaluate; write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="of what is wrong and of the throws; a new one each time without it")
    seed = parser.parse_args().seed
    seed = secrets.randbelow(10**6) if seed is None else seed
    console, sealed = Console(), Sealed.drawn(seed)
    steps = Steps(console)
    simulator = stated_simulator(FOLDER / "cube.xml")
    console.say(f"Something is wrong with {simulator}. What it is is sealed: SHA-256 {sealed.sha256}")

    console.say(
        f"\nA cube unlike that of {simulator} is tossed {WORLD.tosses} times in MuJoCo, and filmed (seed {seed})."
    )
    with steps.timed("film"), logged(console), console.shares("tossing and filming") as progress:
        film(sealed, seed, RECORDING, progress=lambda _, share: progress("", share))
    # a shape needs every toss that it can get: most are trained on
    read = ("source=frames", f"source.path={RECORDING}", "object=cube", "splits=[0.7,0.15,0.15]")
    steps.command("ingest", *read, f"out={DATASET}")
    gap = steps.command("diagnose", f"data={DATASET}", "sim=mjcf", f"sim.path={simulator}", f"out={FOLDER / 'gap'}")
    seal = Opened.of(sealed, gap)
    console.say(f"\nThe seal is opened: {sealed.text}")
    console.table(["", "in cube.xml", "sealed truth", "found (95 %)"], [seal.row])
    console.say(judgement(seal))

    keys = ("model=cnrpi", f"data={DATASET}", "object=unknown", f"object.mass={MASS}")
    trained = steps.command("train", *keys)
    scores = steps.command("evaluate")
    with steps.timed("page"):
        page = write_page(seal, gap, trained, scores, steps.rows)
    rows = [*steps.rows, ("all", sum(row[1] for row in steps.rows), sum(row[2] for row in steps.rows))]
    console.table(["step", "seconds", "of processor time"], [[name, *(f"{x:.0f}" for x in t)] for name, *t in rows])
    console.say(f"Open {page}")


def judgement(seal: Opened) -> str:
    """Whether the demo succeeded, in a sentence."""
    if seal.right:
        return "Named, and nothing else."
    if seal.value is None:
        return "Missed: the effect was not named. docs/results/demo.md says how often that happens, and why."
    return f"Named, but not as it should be: with others, or off by more than {100 * WITHIN:.0f} % of the change."


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


def pose_rows() -> list[list[str]]:
    """How many tosses were found, and how far their poses are from the truth."""
    from tossid.store import read_dataset

    truth, seen = read_dataset(RECORDING / "truth.h5"), read_dataset(DATASET)
    distance, turn = pose_errors(truth, seen)
    return [
        ["tosses found", f"{len(seen.tosses)} of {len(truth.tosses)}"],
        ["pose error, median", f"{np.median(distance):.3f} mm, {np.median(turn):.3f}°"],
        ["pose error, worst", f"{distance.max():.2f} mm, {turn.max():.2f}°"],
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

SHOWN = ("hull_over_tosses", "toss_median", "learned_geometry", "training_curves", "errors_along_rollout")
"""Pictures of the training and of the evaluation that the page shows."""


def write_page(
    seal: Opened,
    gap: dict[str, Any],
    trained: dict[str, Any],
    scores: dict[str, Any],
    steps: list[tuple[str, float, float]],
) -> Path:
    """Write outputs/demo/index.html, with the pictures beside it.

    Args:
        seal: What was wrong, and what was found.
        gap: Of `tossid diagnose`.
        trained: Of `tossid train`.
        scores: Of `tossid evaluate`.
        steps: What each step took.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from pipelines.files.checkpoints import trained_model
    from pipelines.tracking.runs import find_run

    pictures = FOLDER / "pictures"
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir()
    write_film(pictures)
    model = trained_model(find_run(trained["run"]))
    write_comparison(model, gap.get("patched_mjcf"), pictures)
    for path in map(Path, [*trained["figures"], *scores["figures"]]):
        if path.stem in SHOWN:
            shutil.copyfile(path, pictures / path.name)
    page = Environment(loader=PackageLoader("pipelines", "pages"), autoescape=True, undefined=StrictUndefined)
    text = page.get_template("demo.html.j2").render(
        seal=seal,
        judgement=judgement(seal),
        gap=gap,
        learned=learned_rows(model, seal.sealed, scores),
        poses=pose_rows(),
        steps=steps,
        dataset=DATASET,
        simulator=FOLDER / "cube.xml",
        pictures={path.stem: f"{pictures.name}/{path.name}" for path in sorted(pictures.iterdir())},
    )
    out = FOLDER / "index.html"
    out.write_text(text, encoding="utf-8")
    return out


STRIP = 6
"""Pictures of the film strip."""
FILM_STRIDE, FILM_MS = 2, 40
"""Every so many-th frame is in the film, and stays so long [ms]: a third of the true speed."""


def write_film(folder: Path) -> None:
    """Write the first toss as the first camera saw it, cut to where the cube is: film.gif, and strip_K.png.

    Args:
        folder: Where they go.
    """
    from PIL import Image

    from tossid.evaluation.figures import save_film
    from tossid.store import read_dataset
    from tossid.vision.recordings.formats.frames import read_recording

    recording, toss = read_recording(RECORDING), read_dataset(RECORDING / "truth.h5").tosses[0]
    frames = [
        np.asarray(Image.open(frame.path).convert("L"))
        for frame in recording.frames[recording.cameras[0].name]
        if toss.t[0] <= 1e-9 * frame.t_ns <= toss.t[-1]
    ]
    images = np.stack(frames)[:, *moving_part(np.stack(frames))]
    save_film(np.repeat(images[::FILM_STRIDE, ..., None], 3, axis=-1), folder / "film.gif", frame_ms=FILM_MS)
    for k, at in enumerate(np.linspace(0, len(images) - 1, STRIP).round().astype(int)):
        Image.fromarray(images[at]).save(folder / f"strip_{k}.png")


MOVED, ROOM = 40, 20
"""Grey levels by which a pixel changes that something moves through, and pixels that are left around these."""


def moving_part(images: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of images (n, h, w) in which something moves."""
    moved = np.ptp(images, axis=0) > MOVED
    rows, columns = np.flatnonzero(moved.any(axis=1)), np.flatnonzero(moved.any(axis=0))
    return tuple(slice(max(0, each[0] - ROOM), each[-1] + ROOM) for each in (rows, columns))  # type: ignore[return-value]


def write_comparison(model: TrainedModel, patched: str | None, folder: Path) -> None:
    """Draw a toss that the learned model has not seen: as measured, and by cube.xml, by patched.xml, and as learned.

    It is the test toss that cube.xml predicts as well as half of them.

    Args:
        model: The learned model.
        patched: The patched file; None where nothing was found.
        folder: Where comparison.png goes.
    """
    from tossid.evaluation.figures import toss_comparison
    from tossid.store import read_dataset

    tosses = read_dataset(DATASET).split("test").tosses
    before = [in_mujoco(FOLDER / "cube.xml", toss) for toss in tosses]
    far = [
        np.linalg.norm(run.q[:, :3] - toss.q[:, :3], axis=1).mean() for run, toss in zip(before, tosses, strict=True)
    ]
    i = int(np.argsort(far)[len(far) // 2])
    rollouts = {"cube.xml": before[i]}
    if patched is not None:
        rollouts["patched.xml"] = in_mujoco(Path(patched), tosses[i])
    rollouts["cnrpi"] = learned(model, tosses[i])
    title = f"Toss {tosses[i].name}: in {', in '.join([*rollouts][:-1])}, and learned from nothing"
    toss_comparison(tosses[i], rollouts, load_object("cube"), title=title).savefig(folder / "comparison.png")


def in_mujoco(mjcf: Path, toss: Toss) -> Rollout:
    """A toss in a user's MuJoCo model, from what its free flight says of its start.

    Args:
        mjcf: The model.
        toss: As measured.
    """
    from tossid.diagnosis.likelihood.engine_discrepancy import MujocoWorld
    from tossid.diagnosis.localisation.rollouts import first_states
    from tossid.diagnosis.simulators import world_of_mjcf
    from tossid.objects.files.model_file import read_model_file
    from tossid.types import Rollout, frame_time

    world, _ = world_of_mjcf(mjcf, width=load_object("cube").width)
    (q0, v0), dt = first_states([toss], world), frame_time([toss])
    at = toss.ticks(dt)
    q = MujocoWorld(read_model_file(mjcf).compiled(), world).roll_out(q0, v0, n_steps=at[-1:], dt=dt)[0, at]
    return Rollout(toss.t, q, np.full_like(toss.v, np.nan), np.zeros((len(toss), 8)))


def learned(trained: TrainedModel, toss: Toss) -> Rollout:
    """A toss as a trained model predicts it, from what its free flight says of its start."""
    from tossid.evaluation.metrics import roll_out

    model = trained.model
    how: dict[str, Any] = {"measurement": model.measurement, "from_flight": True}
    return roll_out(model.simulator(), trained.object, [toss], **how)[0]


def learned_rows(trained: TrainedModel, sealed: Sealed, scores: dict[str, Any]) -> list[list[str]]:
    """What was learned of the cube beside what is true of it.

    Args:
        trained: The learned model.
        sealed: What the true cube has otherwise.
        scores: Of `tossid evaluate`.
    """
    effect = effect_named(sealed.effect)
    nominal = World(load_object("cube"))
    true = effect.at(nominal, effect.values_with(nominal, {sealed.parameter: sealed.value})).object
    both = (trained.model.learned_object(), true)
    position, rotation = (scores[key]["mean"] for key in ("position_error_pct", "rotation_error_deg"))
    rows: dict[str, tuple[float, str, Callable[[ObjectModel], Any]]] = {
        "extent [mm]": (1e3, ".1f", lambda cube: np.ptp(cube.drawn.corner_pos, axis=0)),
        "centre of mass [mm]": (1e3, ".1f", lambda cube: cube.com[0]),
        "inertia [kg cm²]": (1e4, ".2f", lambda cube: np.diag(cube.inertia[0])),
        "friction": (1.0, ".3f", lambda cube: [cube.friction]),
    }
    out = [
        [name, *(", ".join(f"{factor * x + 0.0:{digits}}" for x in of(cube)) for cube in both)]
        for name, (factor, digits, of) in rows.items()
    ]
    return [
        *out,
        ["error over whole tosses that it has not seen", f"{position:.1f} % of the width, {rotation:.1f}°", ""],
    ]


if __name__ == "__main__":
    sys.exit(guarded(main, "demo"))
