"""`tossid audit`: does `diagnose` find what it is not told?

A case is made, sealed, diagnosed, unsealed and scored by processes that share files only: the diagnosis is given a
dataset that came through TUM files, and nothing else. The truth lies in OUT/.sealed, unreadable, and its hash stands
in the case's seal.txt and in OUT/seals.txt before the diagnosis starts.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import secrets
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.calling import jsonable
from pipelines.console import Console
from pipelines.outputs import only_writer, output_file, output_folder
from pipelines.schemas import AuditConfig
from tossid.errors import ConfigError, FileError, InputError, SolverError, TossidError

if TYPE_CHECKING:
    from tossid.diagnosis.audit import Case
    from tossid.objects import ObjectModel
    from tossid.physics.effects import World

FOLDER = Path("outputs/audit")
RESULT, TRUTH, GAP, SEAL = "result.json", "truth.json", "gap.json", "seal.txt"
ANSWER = "answer.json"
"""What an unspoilt simulator's first diagnosis finds."""
LCP_SUBSTEPS = 64
"""Steps a frame of cases in tossid's own engine. Compliant contact stepped at h has k h more damping than stated."""
THROWS, SECONDS = 16, 0.9
"""Throws, and their length [s], by which strengths are found."""
_NO_ANSWERS = ("figures", "report", "words", "audit_figures", "next_toss", "patch", "patch_edits", "patch_rerun")


@dataclass(frozen=True)
class Job:
    """A case with the settings that its result depends on. answer: the unspoilt simulator's effects (real tosses)."""

    case: Case
    config: AuditConfig
    digest: str
    answer: dict[str, dict[str, float]] | None = None

    @property
    def name(self) -> str:
        return f"{self.case.index:03d}-{self.digest[:8]}"


def run(config: AuditConfig, console: Console) -> dict[str, Any]:
    """Audit; returns the summary, a row a case, and where all of it lies."""
    from pipelines.project import load_object
    from pipelines.tracking import tracked_run

    started = time.perf_counter()
    if not config.engines:
        raise ConfigError("engines", "is empty; an audit needs at least one.")
    if load_object(config.object).n_joints:
        raise ConfigError("object", f"'{config.object.name}' has joints; diagnosis is of single bodies so far.")
    out = config.out or FOLDER / (f"{config.seed}" if config.data is None else f"real-{config.seed}")
    count = min(config.workers or os.cpu_count() or 1, config.cases)
    with only_writer(out / "audit"), _workers(count) as pool:
        jobs = _jobs(config, out, pool, console)
        results = {job.name: there for job in jobs if (there := _stored(out, job)) is not None}
        console.say(f"{out}: {len(results)} of {len(jobs)} cases are done")
        failed: dict[str, str] = {}
        with console.progress("auditing", len(jobs), unit="cases") as bar:
            bar.advance(len(results))
            missing = [job for job in jobs if job.name not in results]
            for job, found in _all_of(missing, out, pool, threads=count):
                if isinstance(found, TossidError):
                    failed[job.name] = str(found)
                    console.warn(f"case {job.name}: {found}")
                else:
                    results[job.name] = found
                bar.advance(1, note=job.name)
        if not results:
            raise InputError(f"all {len(failed)} cases failed; the first: {next(iter(failed.values()))}")
        with tracked_run(f"audit-{out.name}", config, command="audit") as tracked:
            report = _report(out, [results[job.name] for job in jobs if job.name in results], failed, console)
            numbers = {name: value.get("share", value.get("value")) for name, value in report["summary"].items()}
            tracked.metrics({name: float(x) for name, x in numbers.items() if x is not None})
            for name in ("audit.json", "table.md", "figures"):
                tracked.artifact(out / name)
    return {**report, "out": str(out), "run": tracked.id, "seconds": time.perf_counter() - started}


# ---------------------------------------------------------------- which cases


def _jobs(config: AuditConfig, out: Path, pool: ProcessPoolExecutor, console: Console) -> list[Job]:
    from pipelines.project import dataset_path
    from tossid.diagnosis.audit import draw_cases, draw_spoilt
    from tossid.store import file_sha256

    answer = None
    settings: dict[str, Any] = {"object": asdict(config.object), "code": _code()}
    if config.data is not None:
        settings |= {"data": file_sha256(dataset_path(config.data)), "tosses": config.tosses, "seed": config.seed}
        key = _digest(settings)
        answer = _answer(out, key)
        if answer is None:
            console.say(f"{config.data}: diagnosing the unspoilt simulator")
            answer = pool.submit(find_answer, config, os.cpu_count() or 1).result()
            _write(out / ANSWER, json.dumps({"key": key, "effects": answer}, indent=1) + "\n")
        console.say(f"the unspoilt simulator has {', '.join(answer) or 'no effects'}")
        cases = draw_spoilt(config.cases, seed=config.seed)
    else:
        settings |= {k: getattr(config, k) for k in ("tosses", "position_noise", "rotation_noise")}
        cases = draw_cases(
            config.cases,
            seed=config.seed,
            engines=config.engines,
            displacement=config.displacement,
            only_lcp=_only_lcp(config),
        )
    return [Job(case, config, _digest({**settings, "case": case.as_json()}), answer) for case in cases]


def _only_lcp(config: AuditConfig) -> list[str]:
    """Effects that MuJoCo cannot express."""
    import numpy as np

    from pipelines.project import load_object
    from tossid.diagnosis.audit import STRENGTHS, world_with
    from tossid.physics.effects import World
    from tossid.physics.effects.in_mujoco import inexpressible

    plain, u = World(load_object(config.object)), np.full(8, 0.5)
    return [name for name, s in STRENGTHS.items() if inexpressible(world_with(plain, {name: s.values(s.high, u)}))]


def _digest(values: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(jsonable(values), sort_keys=True).encode()).hexdigest()


def _code() -> str:
    """A hash of the code that answers depend on."""
    from pipelines.version import ROOT, code_digest

    found = hashlib.sha256(code_digest().encode())
    for path in sorted((ROOT / "tossid" / "diagnosis").glob("*.py")):
        if path.stem not in _NO_ANSWERS:
            found.update(path.read_bytes())
    return found.hexdigest()


def _answer(out: Path, key: str) -> dict[str, dict[str, float]] | None:
    try:
        found = json.loads((out / ANSWER).read_text())
    except (OSError, ValueError):
        return None
    return dict(found["effects"]) if found.get("key") == key else None


def _stored(out: Path, job: Job) -> dict[str, Any] | None:
    """A case that is done."""
    try:
        found = json.loads((out / "cases" / job.name / RESULT).read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("digest") == job.digest else None


# ---------------------------------------------------------------- a case, from its making to its score


def _all_of(
    jobs: Sequence[Job], out: Path, pool: ProcessPoolExecutor, *, threads: int
) -> Iterator[tuple[Job, dict[str, Any] | TossidError]]:
    """Each case with its result (or the error that it ended in), as they are done."""
    if not jobs:
        return
    with ThreadPoolExecutor(threads) as guards:
        waiting = {guards.submit(_one, job, out, pool): job for job in jobs}
        try:
            for done in as_completed(waiting):
                try:
                    yield waiting[done], done.result()
                except BrokenProcessPool as error:
                    problem = "a process died (of lack of memory?); give the same command again, with workers=1"
                    raise SolverError(problem, total=threads) from error
                except TossidError as error:
                    yield waiting[done], error
        except BaseException:
            guards.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():  # else the threads would wait for their cases
                child.terminate()
            raise


def _one(job: Job, out: Path, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Make, seal, diagnose, unseal, score; the case's folder appears whole."""
    started = time.perf_counter()
    with output_folder(out / "cases" / job.name, made_by="tossid audit") as folder:
        sealed = _seal(pool.submit(make_case, job, folder).result(), job, out, folder)
        if job.answer is None:
            gap = pool.submit(diagnose_case, folder / "tosses.h5", job.case.without, job.case.seed).result()
        else:
            simulator = pool.submit(spoilt_world, job).result()
            gap = pool.submit(diagnose_spoilt, job.config, simulator, job.case.seed).result()
        (folder / GAP).write_text(json.dumps(jsonable(gap), indent=1, allow_nan=False) + "\n")
        truth = _unseal(sealed, folder)
        result = pool.submit(judge, folder, truth, jsonable(gap), job.case.seed).result()
        result |= {"digest": job.digest, "name": job.name, "seconds": time.perf_counter() - started}
        (folder / RESULT).write_text(json.dumps(jsonable(result), indent=1, allow_nan=False) + "\n")
    return dict(jsonable(result))


def seal(truth: dict[str, Any]) -> tuple[bytes, str]:
    """The truth with a nonce, as it is sealed, and its SHA-256."""
    content = json.dumps(jsonable({**truth, "nonce": secrets.token_hex(16)}), indent=1, sort_keys=True).encode()
    return content, hashlib.sha256(content).hexdigest()


def _seal(truth: dict[str, Any], job: Job, out: Path, folder: Path) -> Path:
    """Lay the truth away where the diagnosis does not look, unreadable, and publish its hash; returns where."""
    content, sha256 = seal(truth)
    path = out / ".sealed" / f"{job.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    path.write_bytes(content)
    path.chmod(0)
    (folder / SEAL).write_text(f"{sha256}\n")
    with (out / "seals.txt").open("a") as file:
        file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} {job.name} {sha256}\n")
    return path


def _unseal(path: Path, folder: Path) -> dict[str, Any]:
    """The truth, now beside the diagnosis.

    Raises:
        FileError: it is not what was sealed.
    """
    path.chmod(0o600)
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != (folder / SEAL).read_text().strip():
        raise FileError(path, f"is not what was sealed; {SEAL} has another SHA-256")
    (folder / TRUTH).write_bytes(content)
    path.unlink()
    return dict(json.loads(content))


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
    stated = NoiseConfig(config.position_noise, config.rotation_noise, 0.0, 0.0, 0.0, 0.0)
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
        t, cov = np.arange(n) / keys.rate_hz, np.broadcast_to(1e-12 * np.eye(6), (n, 6, 6)).copy()
        phase = label_phases(model, t, q[i, :n], v[i, :n], gravity=keys.gravity)
        tosses.append(Toss(f"{i:0{width}d}", t, q[i, :n], v[i, :n], cov, cov, phase))
    return tuple(tosses)


def diagnose_case(data: Path, without: tuple[str, ...], seed: int) -> dict[str, Any]:
    """gap.json of the nominal simulator on a dataset: all that the diagnosis is told."""
    from tossid.diagnosis.attribution import diagnose
    from tossid.physics.effects import LIBRARY

    tosses, world = _read(data)
    library = tuple(effect for effect in LIBRARY if effect.name not in without)
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
    from tossid.diagnosis.audit import closable_share, score

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


def find_answer(config: AuditConfig, threads: int) -> dict[str, dict[str, float]]:
    """The effects that a diagnosis of the nominal simulator finds, fitted to all tosses: the unspoilt simulator."""
    from tossid.diagnosis.attribution import diagnose

    tosses, world = _real(config)
    found = diagnose(tosses, world, seed=config.seed % 1000, n_threads=threads).hypothesis
    return {
        effect.name: dict(zip((p.name for p in effect.parameters), map(float, values), strict=True))
        for effect, values in zip(found.effects, found.values, strict=True)
    }


def _unspoilt(job: Job) -> World:
    from tossid.diagnosis.audit import world_with

    return world_with(_real(job.config)[1], job.answer or {})


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


# ---------------------------------------------------------------- the whole


def _workers(count: int) -> Any:
    """Processes with one thread each, which share nothing but files."""
    from pipelines.cells import worker_processes

    return worker_processes(None, count)


def _report(out: Path, results: list[dict[str, Any]], failed: dict[str, str], console: Console) -> dict[str, Any]:
    """Table, figures and JSON."""
    from pipelines.pictures import write_figures
    from tossid.diagnosis.audit import summarise
    from tossid.diagnosis.audit_figures import audit_figures

    summary = summarise([result["score"] for result in results])
    rows = [row_of(result) for result in results]
    figures = write_figures(audit_figures(rows), out / "figures")
    report: dict[str, Any] = {"summary": summary, "cases": rows, "failed": failed}
    _write(out / "table.md", _markdown(rows))
    report["figures"] = [str(path) for path in figures]
    _write(out / "audit.json", json.dumps(jsonable(report), indent=1, allow_nan=False) + "\n")
    console.table(
        ["case", "kind", "engine", "truth", "moves", "named", "verdict", "right"],
        [[r["name"], r["kind"], r["engine"], r["truth"], r["moves"], r["named"], r["verdict"], _mark(r)] for r in rows],
    )
    console.table(["measure", "found", "wanted"], [[name, *_in_words(value)] for name, value in summary.items()])
    return report


def row_of(result: dict[str, Any]) -> dict[str, Any]:
    """A case in a table's row."""
    case, score, effects = result["truth"]["case"], result["score"], result["truth"]["effects"]
    reached = list(result["truth"]["displacement"].values())
    first: list[str] = next(iter(score["classes"].values()), [])
    return {
        "name": result["name"],
        "kind": case["kind"],
        "engine": case["engine"],
        "effects": list(effects),
        "truth": "; ".join(f"{name} {_values(values)}" for name, values in effects.items()) or "nothing",
        "displacement": reached,
        "moves": ", ".join(f"{x:.0f}" for x in reached),
        "named": ", ".join("/".join(group) for group in score["classes"].values()) or "nothing",
        "first": score["named"][0] if score["named"] else None,
        "class": first,
        "verdict": score["verdict"],
        "right": score["right"],
        "phase_right": score["phase_right"],
        "closed": score["closed"],
        "covered": [p["covered"] for p in score["parameters"]],
        "seconds": result["seconds"],
    }


def _values(values: dict[str, float]) -> str:
    return " ".join(f"{key}={value:.3g}" for key, value in values.items())


def _mark(row: dict[str, Any]) -> str:
    return "yes" if row["right"] else "NO"


def _in_words(value: dict[str, Any]) -> list[str]:
    wanted = value.get("wanted")
    if "value" in value:
        text = "none" if value["value"] is None else f"{value['value']:.3f} (of {value['of']})"
    else:
        text = f"{value['count']} of {value['of']}"
    return [text, "" if wanted is None else f"{wanted:g}"]


def _markdown(rows: list[dict[str, Any]]) -> str:
    names = ("name", "kind", "engine", "truth", "moves", "named", "verdict", "right", "closed", "covered")
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    for row in rows:
        covered = f"{sum(row['covered'])} of {len(row['covered'])}"
        closed = "" if row["closed"] is None else f"{row['closed']:.2f}"
        shown = {**row, "right": _mark(row), "covered": covered, "closed": closed}
        lines.append("| " + " | ".join(str(shown[name]) for name in names) + " |")
    return "\n".join(lines) + "\n"


def _write(path: Path, text: str) -> None:
    with output_file(path) as temporary:
        temporary.write_text(text)
