"""`tossid audit`: does `diagnose` find what it is not told?

A case is made, sealed, diagnosed, unsealed and scored by processes that share files only: the diagnosis is given a
dataset that came through TUM files, and nothing else. The truth lies in OUT/.sealed, unreadable, and its hash stands
in the case's seal.txt and in OUT/seals.txt before the diagnosis starts.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from pipelines.audit_case import (
    Answer,
    Job,
    diagnose_case,
    diagnose_spoilt,
    find_answer,
    judge,
    make_case,
    spoilt_world,
)
from pipelines.calling import digest_of, jsonable
from pipelines.console import Console
from pipelines.outputs import only_writer, output_file, output_folder
from pipelines.project import absolute_object
from pipelines.schemas import AuditConfig
from pipelines.version import code_digest_with
from pipelines.workers import Workers, as_done, open_workers
from tossid.errors import ConfigError, FileError, InputError, TossidError

FOLDER = Path("outputs/audit")
RESULT, TRUTH, GAP, SEAL = "result.json", "truth.json", "gap.json", "seal.txt"
ANSWER = "answer.json"
"""What an unspoilt simulator's first diagnosis finds."""
_NO_ANSWERS = (
    "figures",
    "report",
    "words",
    "audit_figures",
    "place_figures",
    "witnesses",
    "next_toss",
    "edit",
    "patch",
    "patch_edits",
    "patch_rerun",
)


def run(config: AuditConfig, console: Console) -> dict[str, Any]:
    """Audit; returns the summary, a row a case, and where all of it lies."""
    from pipelines.project import load_object
    from pipelines.tracking import tracked_run

    started = time.perf_counter()
    if not config.engines:
        raise ConfigError("engines", "is empty; an audit needs at least one.")
    if config.data is not None and load_object(config.object).n_joints:
        raise ConfigError(
            "data", "only simulators of single bodies are spoilt; leave it out to make cases of the object."
        )
    out = config.out or FOLDER / (f"{config.seed}" if config.data is None else f"real-{config.seed}")
    processes = min(config.workers or os.cpu_count() or 1, config.cases)
    with (
        only_writer(out / "audit"),
        ExitStack() as last,
        open_workers(config.launcher, processes) as pool,
    ):
        # a thread leads a case through what workers do of it; it ends after them, else it would wait for them
        lead = last.enter_context(ThreadPoolExecutor(config.workers or pool.count))
        jobs = _jobs(config, out, pool, console)
        results = {job.name: there for job in jobs if (there := _stored(out, job)) is not None}
        console.say(f"{out}: {len(results)} of {len(jobs)} cases are done")
        failed: dict[str, str] = {}
        with console.progress("auditing", len(jobs), unit="cases") as bar:
            bar.advance(len(results))
            missing = [job for job in jobs if job.name not in results]
            for job, found in as_done(partial(_one, out=out, pool=pool), missing, lead.submit):
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


def _jobs(config: AuditConfig, out: Path, pool: Workers, console: Console) -> list[Job]:
    from pipelines.project import dataset_path, load_object
    from tossid.diagnosis.audit import draw_cases, draw_spoilt, strengths_for
    from tossid.store import file_sha256

    answer = None
    settings: dict[str, Any] = {"object": asdict(config.object), "code": code_digest_with("diagnosis", _NO_ANSWERS)}
    if config.data is not None:
        settings |= {"data": file_sha256(dataset_path(config.data)), "tosses": config.tosses, "seed": config.seed}
        key = digest_of(settings)
        answer = _answer(out, key)
        if answer is None:
            console.say(f"{config.data}: diagnosing the unspoilt simulator")
            answer = pool.submit(find_answer, _absolute(config), os.cpu_count() or 1).result()
            _write(out / ANSWER, json.dumps({"key": key, "answer": answer}, indent=1) + "\n")
        console.say(f"the unspoilt simulator has {', '.join(answer['effects']) or 'no effects'}")
        cases = draw_spoilt(config.cases, seed=config.seed)
    else:
        settings |= {k: getattr(config, k) for k in ("tosses", "position_noise", "rotation_noise")}
        cases = draw_cases(
            config.cases,
            seed=config.seed,
            engines=config.engines,
            displacement=config.displacement,
            effects=list(strengths_for(load_object(config.object))),
            only_lcp=_only_lcp(config),
        )
    told = _absolute(config)
    return [Job(case, told, digest_of({**settings, "case": case.as_json()}), answer) for case in cases]


def _absolute(config: AuditConfig) -> AuditConfig:
    """The keys with whole paths: workers may be in another folder."""
    from pipelines.project import dataset_path

    data = None if config.data is None else dataset_path(config.data).resolve()
    return replace(config, data=data, object=absolute_object(config.object))


def _only_lcp(config: AuditConfig) -> list[str]:
    """Effects that MuJoCo cannot express."""
    import numpy as np

    from pipelines.project import load_object
    from tossid.diagnosis.audit import strengths_for, world_with
    from tossid.physics.effects import World
    from tossid.physics.effects.in_mujoco import inexpressible

    plain, u = World(load_object(config.object)), np.full(8, 0.5)
    strengths = strengths_for(plain.object)
    return [name for name, s in strengths.items() if inexpressible(world_with(plain, {name: s.values(s.high, u)}))]


def _answer(out: Path, key: str) -> Answer | None:
    try:
        found = json.loads((out / ANSWER).read_text())
    except (OSError, ValueError):
        return None
    return dict(found["answer"]) if found.get("key") == key else None


def _stored(out: Path, job: Job) -> dict[str, Any] | None:
    """A case that is done."""
    try:
        found = json.loads((out / "cases" / job.name / RESULT).read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("digest") == job.digest else None


# ---------------------------------------------------------------- a case, from its making to its score


def _one(job: Job, *, out: Path, pool: Workers) -> dict[str, Any]:
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


# ---------------------------------------------------------------- the whole


def _report(out: Path, results: list[dict[str, Any]], failed: dict[str, str], console: Console) -> dict[str, Any]:
    """Table, figures and JSON."""
    from pipelines.pictures import write_figures
    from tossid.diagnosis.audit_figures import audit_figures
    from tossid.diagnosis.audit_scores import summarise

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
