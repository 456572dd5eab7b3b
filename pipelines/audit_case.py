"""A case of the audit: made and written as TUM files, diagnosed, and scored; each step reads the last one's files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.schemas import AuditConfig

if TYPE_CHECKING:
    from tossid.diagnosis.audit import Case
    from tossid.objects import ObjectModel
    from tossid.physics.effects import World

LCP_SUBSTEPS = 64
"""Steps a frame of cases in tossid's own engine."""
THROWS, SECONDS = 16, 0.9
"""Throws, and their length [s], by which strengths are found."""


Answer = dict[str, dict[str, dict[str, float]]]
"""Of real tosses: the unspoilt simulator's "effects", and by name what each effect "alone" is fitted to beside them."""


@dataclass(frozen=True)
class Job:
    """A case with the settings that its result depends on. answer: of real tosses."""

    case: Case
    config: AuditConfig
    digest: str
    answer: Answer | None = None

    @property
    def name(self) -> str:
        return f"{self.case.index:03d}-{self.digest[:8]}"


# ---------------------------------------------------------------- what the processes do


def make_case(job: Job, folder: Path) -> dict[str, Any]:
    """Synthesize a case, write it as TUM files, and ingest those: tosses.h5 in the folder. Returns the truth."""
    import numpy as np

    from pipelines import ingest
    from pipelines.config import load
    from pipelines.project import load_object
    from pipelines.schemas import IngestConfig, NoiseConfig, SynthesizeConfig
    from pipelines.tossing import add_noise, draw_releases, make_tosses
    from tossid.diagnosis.audit import OUTSIDE, settled
    from tossid.physics.effects import World
    from tossid.store import write_tum

    case, config = job.case, job.config
    if job.answer is not None:
        return _spoilt_truth(job)
    # far shorter steps than the diagnosis takes: the truth must not share its errors
    steps = [f"engine.substeps={LCP_SUBSTEPS}"] if case.engine == "lcp" else []
    keys = load("synthesize", SynthesizeConfig, ["frames=false", f"engine={case.engine}", *steps])
    keys = replace(keys, object=config.object, tosses=config.tosses)
    model = load_object(config.object)
    world, dt = World(model, gravity=keys.gravity), 1 / keys.rate_hz
    throws = draw_releases(model, keys.release, THROWS, gravity=keys.gravity, rng=np.random.default_rng([case.seed, 4]))
    effects, reached = {}, {}
    for i, (name, target) in enumerate(zip(case.effects, case.targets, strict=True)):
        effects[name], reached[name] = settled(
            name,
            target,
            world,
            *throws,
            noise=config.position_noise,
            n_steps=round(SECONDS * keys.rate_hz),
            dt=dt,
            seed=case.seed + i,
        )
    motion, noise = np.random.default_rng([case.seed, 5]).spawn(2)
    outside = {name: values for name, values in effects.items() if name in OUTSIDE}
    if outside:
        tosses = _pushed_tosses(keys, model, world, outside, case.seed, motion)
    else:
        tosses, _ = make_tosses(replace(keys, effects=effects), model, motion)
    stated = NoiseConfig(config.position_noise, config.rotation_noise, config.rotation_noise, 0.0, 0.0, 0.0)
    write_tum(folder / "tum", add_noise(tosses, model, stated, noise))
    reading = load("ingest", IngestConfig, ["source=tum", f"source.path={folder / 'tum'}"])
    ingest.run(replace(reading, object=config.object, out=folder / "tosses.h5"), Console(quiet=True))
    return {"case": case.as_json(), "effects": effects, "displacement": reached}


def _pushed_tosses(keys: Any, model: ObjectModel, world: World, forces: dict[str, Any], seed: int, rng: Any) -> Any:
    """Tosses under a force that the library has not, as `make_tosses` makes them."""
    import numpy as np

    from pipelines.tossing import cut_at_rest, draw_releases
    from tossid.diagnosis.audit import motion, push_of
    from tossid.motion import label_phases
    from tossid.types import Toss

    ((name, values),) = forces.items()
    q0, v0 = draw_releases(model, keys.release, keys.tosses, gravity=keys.gravity, rng=rng)
    push = push_of(name, values, count=keys.tosses, seconds=keys.seconds, seed=seed)
    q, v = motion(world, q0, v0, n_steps=round(keys.seconds * keys.rate_hz), dt=1 / keys.rate_hz, push=push)
    width, tosses = len(str(keys.tosses - 1)), []
    for i in range(keys.tosses):
        n = cut_at_rest(model, q[i], v[i], rate_hz=keys.rate_hz, rest_s=keys.rest_s)
        t, cov = np.arange(n) / keys.rate_hz, np.broadcast_to(1e-12 * np.eye(model.nv), (n, model.nv, model.nv)).copy()
        phase = label_phases(model, t, q[i, :n], v[i, :n], gravity=keys.gravity)
        tosses.append(Toss(f"{i:0{width}d}", t, q[i, :n], v[i, :n], cov, cov, phase))
    return tuple(tosses)


def diagnose_case(data: Path, without: tuple[str, ...], seed: int) -> dict[str, Any]:
    """gap.json of the nominal simulator on a dataset: all that the diagnosis is told."""
    from tossid.diagnosis.attribution import diagnose
    from tossid.physics.effects import library_for

    tosses, world = _read(data)
    library = tuple(effect for effect in library_for(world.object) if effect.name not in without)
    return diagnose(tosses, world, library=library, seed=seed % 1000).as_json()


def _read(data: Path) -> tuple[Any, World]:
    """The tosses that are long enough, and the nominal simulator of their object."""
    from tossid.diagnosis.windows import LENGTH
    from tossid.physics.effects import World
    from tossid.store import read_dataset

    dataset = read_dataset(data)
    return tuple(toss for toss in dataset.tosses if len(toss) > LENGTH // 2), World(dataset.object)


def judge(folder: Path, truth: dict[str, Any], gap: dict[str, Any], seed: int) -> dict[str, Any]:
    """A diagnosis scored."""
    from tossid.diagnosis.audit_scores import closable_share, score

    closable = None
    if truth["case"]["kind"] in ("effect", "pair"):
        tosses, world = _read(folder / "tosses.h5")
        closable = closable_share(tosses, world, truth["effects"], seed=seed % 1000)
    return {"truth": truth, "score": score(truth, gap, closable=closable), "closable": closable, "gap": _short(gap)}


def _short(gap: dict[str, Any]) -> dict[str, Any]:
    """What a person wants to know of a wrong case."""
    findings = [
        {"name": f["name"], "verdict": f["verdict"], **f["evidence"], "gap_closed": f["gap_closed"]["value"],
         "parameters": {k: v["value"] for k, v in f["parameters"].items()}}
        for f in gap["effects"]
        if f["verdict"] in ("identified", "confusable") or f["evidence"]["gain"] > 0
    ]  # fmt: skip
    total = gap["gap"]["total"]["value"]
    return {"total": total, "noise_floor": gap["gap"]["noise_floor"], "left": gap["gap_left"]["value"],
            "gap_closed": gap["explanation"]["gap_closed"]["value"],
            "unexplained_where": gap["explanation"]["unexplained_where"], "findings": findings,
            "seconds": gap["seconds"]}  # fmt: skip


# ---------------------------------------------------------------- spoilt simulators on real tosses


def _real(config: AuditConfig) -> tuple[Any, World]:
    """As many of the real tosses as the keys say, drawn by the seed, and the nominal simulator of their object."""
    import numpy as np

    from pipelines.project import dataset_path

    tosses, world = _read(dataset_path(config.data))
    chosen = np.random.default_rng([config.seed, 6]).permutation(len(tosses))[: config.tosses]
    return tuple(tosses[i] for i in sorted(chosen)), world


def find_answer(config: AuditConfig, threads: int) -> Answer:
    """What a diagnosis of the nominal simulator finds, fitted to the tosses, and what each parameter that is to be
    spoilt would then be fitted to by itself."""
    from tossid.diagnosis.attribution import diagnose
    from tossid.diagnosis.audit import SPOILT, world_with
    from tossid.diagnosis.audit_scores import fits_alone

    (tosses, world), seed = _real(config), config.seed % 1000
    found = diagnose(tosses, world, seed=seed, n_threads=threads).hypothesis
    effects = {effect.name: effect.named(values) for effect, values in zip(found.effects, found.values, strict=True)}
    return {
        "effects": effects,
        "alone": fits_alone(tosses, world_with(world, effects), tuple(SPOILT), seed=seed, n_threads=threads),
    }


def _unspoilt(job: Job) -> World:
    """The nominal simulator with what was found, and with the parameter that is spoilt next as these tosses have it."""
    from tossid.diagnosis.audit import world_with

    assert job.answer is not None
    name = job.case.effects[0]
    world = world_with(_real(job.config)[1], job.answer["effects"])
    return world_with(world, {name: job.answer["alone"][name]})


def _spoil(job: Job, unspoilt: World) -> dict[str, float]:
    """Values of the effect that spoils the simulator: gravity by a sum, friction by a factor."""
    import numpy as np

    from tossid.diagnosis.audit import SPOILT

    rng = np.random.default_rng([job.case.seed, 3])
    strength = SPOILT[job.case.effects[0]]
    size = float(np.exp(rng.uniform(np.log(strength.low), np.log(strength.high))))
    values = {key: float(x) for key, x in strength.values(size, rng.uniform(-1, 1, 8)).items()}
    now = {"g_ms2": values.get("g_ms2", 0) + unspoilt.gravity, "mu": values.get("mu", 1) * unspoilt.object.friction}
    return {key: now.get(key, x) for key, x in values.items()}


def spoilt_world(job: Job) -> World:
    """The spoilt simulator, as numbers."""
    from tossid.diagnosis.audit import world_with

    unspoilt = _unspoilt(job)
    return world_with(unspoilt, {job.case.effects[0]: _spoil(job, unspoilt)})


def _spoilt_truth(job: Job) -> dict[str, Any]:
    """What restores the simulator."""
    unspoilt = _unspoilt(job)
    spoilt = _spoil(job, unspoilt)
    back = {"g_ms2": unspoilt.gravity, "mu": unspoilt.object.friction}
    found = {
        key: back[key] if key in back else 1 / value if key.endswith("_rel") else -value
        for key, value in spoilt.items()
    }
    return {"case": job.case.as_json(), "effects": {job.case.effects[0]: found}, "spoilt": spoilt, "displacement": {}}


def diagnose_spoilt(config: AuditConfig, simulator: World, seed: int) -> dict[str, Any]:
    """gap.json of a simulator on real tosses."""
    from tossid.diagnosis.attribution import diagnose

    return diagnose(_real(config)[0], simulator, seed=seed % 1000).as_json()
