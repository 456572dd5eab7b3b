"""How often does `make demo` name what is sealed, at its size?

    python -m experiments.demo_seeds OUT.jsonl [--first 1] [--last 20] [--processes 2]

Each seed runs the demo's own functions: the seal is drawn, the cube is tossed in MuJoCo and filmed, the frames are
ingested, and cube.xml is diagnosed with its defaults. What the demo does after it has opened the seal is left out
(training, evaluation, pictures), for the name does not depend on it.

A seed succeeds as `pipelines.seal.Opened.right` has it: the sealed effect is named and no other, and the value that was
found is off by at most a tenth of the true change. Whether the 95 % interval holds the truth is counted beside it.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from pathlib import Path

import numpy as np

import tossid
from experiments.harness import Case, Line, markdown, measured, options, succeeded
from pipelines.cli.failures import guarded
from pipelines.demo import film, stated_simulator
from pipelines.demo_page import pose_errors
from pipelines.seal import WITHIN, Opened, Sealed
from tossid.store import read_dataset

HEADS = ("seed", "effect", "in cube.xml", "truth", "found (95 %)", "right", "interval holds it", "closed")


def processor_seconds() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def one_seed(case: Case) -> Line:
    """What a demo of a seed finds.

    Args:
        case: Its `seed`, of what is wrong and of the throws.
    """
    seed = case["seed"]
    sealed, before = Sealed.drawn(seed), processor_seconds()
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "recording"
        film(sealed, seed, recording)
        dataset = tossid.ingest(recording, object="cube")
        distance, turn = pose_errors(read_dataset(recording / "truth.h5"), dataset)
        found = tossid.diagnose(dataset, simulator=stated_simulator(Path(folder) / "cube.xml"))
    gap = found.as_json()
    seal = Opened.of(sealed, gap)
    return {
        "row": seal.row,
        "named": seal.named,
        "right": seal.right,
        "value": seal.value,
        "ci95": seal.ci95,
        "truth": sealed.value,
        "holds": bool(seal.ci95[0] <= sealed.value <= seal.ci95[1]),
        "verdict": found.verdict,
        "minor": found.minor,
        "brings": gap.get("brings"),
        "pose_mm": [float(np.median(distance)), float(distance.max())],
        "pose_deg": [float(np.median(turn)), float(turn.max())],
        "processor_s": round(processor_seconds() - before, 1),
        "said": str(found),
    }


def row(line: Line) -> list[str]:
    """A line of the table of `HEADS`."""
    brings = (line["brings"] or {}).get("position_error_mm")
    closed = f"{brings['before']:.1f} → {brings['after']:.2f} mm" if brings else ""
    return [str(line["seed"]), *line["row"], *("yes" if line[key] else "no" for key in ("right", "holds")), closed]


def main(arguments: list[str]) -> None:
    """Run the seeds that OUT lacks, and print the table."""
    given = options(__doc__, arguments, out=Path, first=1, last=20, processes=2)
    cases = [{"seed": seed} for seed in range(given.first, given.last + 1)]
    lines = list(succeeded(measured(given.out, cases, one_seed, processes=given.processes)))
    print(markdown(HEADS, map(row, lines)))
    right = sum(line["right"] for line in lines)
    print(f"{right} of {len(lines)} demos name the sealed effect, no other, within {WITHIN:.0%} of its change")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:]), "demo_seeds"))
