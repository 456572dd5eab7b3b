"""How often does `make demo` name what is sealed, at its size?

    python -m experiments.demo_seeds OUT [--seeds 1..20] [--processes 2]

Each seed runs the demo's own functions: the seal is drawn, the cube is tossed in MuJoCo and filmed, the frames are
ingested, and cube.xml is diagnosed with its defaults. What the demo does after it has opened the seal is left out
(training, evaluation, pictures), for the name does not depend on it.

A seed succeeds as `pipelines.seal.Opened.right` has it: the sealed effect is named and no other, and the value that was
found is off by at most a tenth of the true change. Whether the 95 % interval holds the truth is counted beside it.

One JSON line a seed is added to OUT; seeds that it has are not run again. Every call prints the whole file as a table.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import tossid
from pipelines.cli.console import Console
from pipelines.demo import film, processor_seconds, stated_simulator
from pipelines.demo_page import pose_errors
from pipelines.seal import WITHIN, Opened, Sealed
from tossid.store import read_dataset

HEADS = ("seed", "effect", "in cube.xml", "truth", "found (95 %)", "right", "interval holds it", "closed")


def main() -> None:
    """Run the seeds that OUT lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", default="1..20", help="first..last")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    first, last = (int(end) for end in given.seeds.split(".."))
    known = {line["seed"] for line in read_lines(given.out)}
    todo = [seed for seed in range(first, last + 1) if seed not in known]
    console = Console()
    with (
        ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool,
        console.progress("demos", len(todo), unit="seeds") as bar,
    ):
        for done in as_completed([pool.submit(one_seed, seed) for seed in todo]):
            with given.out.open("a", encoding="utf-8") as out:
                out.write(json.dumps(done.result()) + "\n")
            bar.advance(1)
    lines = [line for line in read_lines(given.out) if first <= line["seed"] <= last]
    right = sum(line["right"] for line in lines)
    title = f"{right} of {len(lines)} demos name the sealed effect, no other, within {WITHIN:.0%} of its change"
    console.table(HEADS, [row(line) for line in sorted(lines, key=lambda line: line["seed"])], title=title)


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The lines of a file, if there is one."""
    return [json.loads(text) for text in path.read_text().splitlines()] if path.is_file() else []


def one_seed(seed: int) -> dict[str, Any]:
    """What a demo of this seed finds.

    Args:
        seed: Of what is wrong and of the throws.
    """
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
        "seed": seed,
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
        "candidates": found.candidates,
        "tosses": len(dataset.tosses),
        "pose_mm": [float(np.median(distance)), float(distance.max())],
        "pose_deg": [float(np.median(turn)), float(turn.max())],
        "processor_s": round(processor_seconds() - before, 1),
        "said": str(found),
    }


def row(line: dict[str, Any]) -> list[str]:
    """A line of the table of `HEADS`."""
    name, stated, truth, found = line["row"]
    brings = (line["brings"] or {}).get("position_error_mm")
    closed = f"{brings['before']:.1f} → {brings['after']:.2f} mm" if brings else ""
    return [
        str(line["seed"]),
        name,
        stated,
        truth,
        found,
        *("yes" if line[k] else "no" for k in ("right", "holds")),
        closed,
    ]


if __name__ == "__main__":
    main()
