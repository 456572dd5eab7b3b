"""Diagnoses that `make bench` times.

python -m benchmarks.bench_diagnosis           # these alone
python -m benchmarks.bench_diagnosis data=FILE.h5 [KEY=VALUE ...]    # another dataset

The keys are those of `tossid diagnose`. Three times are of what it says meanwhile: the gap, a first suspect, and what
the search finds, before it is repeated.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

from pipelines.cli.console import Console

COMMAND = (sys.executable, "-m", "pipelines.cli.app")
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
HEADS = ("diagnosis", "elapsed s", "gap after s", "suspect after s", "one search after s", "CPU s", "GiB", "named")


def main() -> None:
    """Print the table."""
    console, keys = Console(), tuple(each for each in sys.argv[1:] if "=" in each)
    if keys:
        console.table(HEADS, [row(" ".join(keys), diagnosed(keys))])
    else:
        diagnoses(console)


def diagnoses(console: Console) -> None:
    """Diagnose every case, and print the table."""
    rows = [row(name, made_and_diagnosed(keys)) for name, keys in CASES.items()]
    console.table(HEADS, rows, title="Diagnoses with the whole library, all cores")


def row(name: str, found: dict[str, Any]) -> list[str]:
    """A row of the table."""
    answers = (f"{found[key]:.1f}" if key in found else "-" for key in ANSWERS)
    named = ", ".join(found["named"]) or "none"
    return [name, f"{found['elapsed_s']:.0f}", *answers, f"{found['cpu_s']:.0f}", f"{found['gib']:.2f}", named]


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
