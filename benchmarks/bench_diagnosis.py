"""Diagnoses that `make bench` times, beside the figures of the last release, which are kept in a file.

python -m benchmarks.bench_diagnosis           # these alone
python -m benchmarks.bench_diagnosis --keep    # and keep them, for a release
python -m benchmarks.bench_diagnosis data=FILE.h5 [KEY=VALUE ...]    # another dataset

The keys are those of `tossid diagnose`. Three times are of what it says meanwhile: the gap, a first suspect, and what
the search finds, before it is repeated.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console

COMMAND = (sys.executable, "-m", "pipelines.cli.app")
KEPT = Path(__file__).with_name("bench_release.json")
"""Figures of a release: version, date, machine, and those of each case."""
NOISE = ("noise.position=0.00015", "noise.rotation=0.0015", "noise.velocity=0.03", "noise.spin=0.3", "frames=false")
CASES: dict[str, tuple[str, ...]] = {
    "12 tosses of MuJoCo, friction 0.3": (
        *NOISE, "effects={friction: {mu: 0.3}}", "engine=mujoco", "tosses=12", "seed=0",
    ),
    "60 tosses of 150 frames, centre of mass 4 mm off, friction 0.26": (
        *NOISE, "engine=lcp", "engine.substeps=32", "tosses=60", "seconds=1.01", "rest_s=2", "seed=1",
        "effects={com_offset: {x_m: 0.004, y_m: 0, z_m: 0}, friction: {mu: 0.26}}",
    ),
}  # fmt: skip
"""What is made and diagnosed with the whole library. A cube of friction 0.18 is stated."""
ANSWERS = {"gap_s": "the gap over", "suspect_s": "next suspect", "search_s": "the search finds"}
"""What the command says before it ends, as a line begins: the last is the end of one search, before its repeats."""
HEADS = (
    "diagnosis", "elapsed s", "gap after s", "suspect after s", "one search after s", "CPU s", "GiB", "named",
    "then: elapsed s", "CPU s", "GiB", "named",
)  # fmt: skip


def main() -> None:
    """Print the table, and keep its figures if asked for."""
    console = Console()
    keys = tuple(each for each in sys.argv[1:] if "=" in each)
    if keys:
        console.table(HEADS, rows({" ".join(keys): diagnosed(keys)}, {}))
        return
    found = diagnoses(console)
    if "--keep" in sys.argv[1:]:
        KEPT.write_text(json.dumps(as_release(found), indent=1) + "\n", encoding="utf-8")
        console.say(f"kept in {KEPT}")


def diagnoses(console: Console) -> dict[str, dict[str, Any]]:
    """Diagnose every case, print the table, and return the figures."""
    kept: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.is_file() else {}
    found = {name: made_and_diagnosed(keys) for name, keys in CASES.items()}
    title = "Diagnoses with the whole library, all cores"
    if kept:
        title += f"; then: {kept['version']}, {kept['date']}, {kept['machine']}"
    console.table(HEADS, rows(found, kept), title=title)
    return found


def rows(found: dict[str, dict[str, Any]], kept: dict[str, Any]) -> list[list[str]]:
    """The table's rows: each case's figures, and those of the release, "-" where it has none."""
    then = kept.get("cases", {})
    table = []
    for name, each in found.items():
        elapsed, *others = _figures(each)
        answers = (_seconds(each.get(key)) for key in ANSWERS)
        table.append([name, elapsed, *answers, *others, *_figures(then.get(name))])
    return table


def _figures(case: dict[str, Any] | None) -> list[str]:
    if case is None:
        return ["-"] * 4
    return [
        f"{case['elapsed_s']:.0f}",
        f"{case['cpu_s']:.0f}",
        f"{case['gib']:.2f}",
        ", ".join(case["named"]) or "none",
    ]


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def as_release(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What is kept of figures: this version, today, this machine."""
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    return {"version": version("tossid"), "date": date.today().isoformat(), "machine": machine, "cases": found}


def made_and_diagnosed(keys: tuple[str, ...]) -> dict[str, Any]:
    """Make tosses and diagnose them, as `diagnosed` does."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*COMMAND, "synthesize", *keys, f"out={folder}/made", "--quiet"], check=True)
        return diagnosed((f"data={folder}/made/tosses.h5",))


def diagnosed(keys: tuple[str, ...]) -> dict[str, Any]:
    """Diagnose by the command line: elapsed and CPU seconds, when answers came, peak memory, names."""
    with tempfile.TemporaryDirectory() as folder, open(f"{folder}/gap.json", "w+b") as out:
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        call = [*COMMAND, "diagnose", *keys, f"out={folder}/gap", "--json"]
        answers: dict[str, float] = {}
        with subprocess.Popen(call, stdout=out, stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            for line in running.stderr:
                for key, words in ANSWERS.items():
                    if line.startswith(words):
                        answers.setdefault(key, round(time.perf_counter() - started, 1))
        elapsed, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
        if running.returncode:
            raise subprocess.CalledProcessError(running.returncode, call)
        out.seek(0)
        named = json.loads(out.read())["explanation"]["effects"]
    return {
        "elapsed_s": round(elapsed, 1),
        **answers,
        "cpu_s": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1),
        "gib": round(after.ru_maxrss / 2**20, 2),
        "named": named,
    }


if __name__ == "__main__":
    from pipelines.cli.failures import guarded

    sys.exit(guarded(main, "bench"))
