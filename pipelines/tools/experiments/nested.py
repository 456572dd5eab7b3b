"""How far judging folds, as every diagnosis has them, are from a search repeated without each fold.

    python -m pipelines.tools.experiments.nested out=LINES.jsonl [folds=4] [tosses=16] [split=train]
        [effects=friction,gravity] FILE.h5 ...
    python -m pipelines.tools.experiments.nested table=LINES.jsonl

For each dataset: the share of the gap that a diagnosis reports as closed, and the share that is closed when the whole
search is repeated on the tosses outside of each fold and judged on that fold in one pass (`explain(unseen=...)`). The
second is exact: neither choice nor fit, whitening or slow errors have seen the tosses that judge. It costs as many
searches as there are folds. Searches are not repeated on resampled tosses, as shares do not depend on that.

One JSON line a dataset, which is not computed again if the file has it. `table` prints the lines in Markdown.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.files.json_lines import add_line, lines_so_far, read_lines
from pipelines.tools.experiments.sensitivity import closed
from tossid.diagnosis.explain import explain
from tossid.diagnosis.problem import Problem
from tossid.diagnosis.selection.cross_validation import draw_folds
from tossid.physics.effects import Effect, World, effects_for
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.store import Dataset, read_dataset


def compare(
    dataset: Dataset,
    library: Sequence[Effect] | None = None,
    *,
    folds: int,
    seed: int = 0,
    settings: DiagnoseSettings = DiagnoseSettings(),
) -> dict[str, Any]:
    """Both shares of one dataset, and the names that each search found; from the object's library if None is given."""
    tosses, world = dataset.tosses, World(dataset.object)
    library = effects_for(dataset.object) if library is None else library
    whole = explain(Problem(tosses, world, library, seed=seed, settings=settings))
    exact = []
    for held in draw_folds(len(tosses), np.random.default_rng(seed), folds):
        training = [toss for toss, out in zip(tosses, held, strict=True) if not out]
        judging = [toss for toss, out in zip(tosses, held, strict=True) if out]
        found = explain(Problem(training, world, library, seed=seed, unseen=judging, settings=settings))
        assert found.unseen is not None
        exact.append({"named": list(found.found), "seconds": found.seconds, **found.unseen.as_json()})
    shares = [each["gap_closed"]["value"] for each in exact]
    weight = [each["n_tosses"] * (each["gap"]["value"] ** 2 - 1.0) for each in exact]
    return {
        "tosses": len(tosses),
        "named": list(whole.found),
        "closed": whole.gap_closed.as_json(),
        "seconds": whole.seconds,
        "exact_closed": float(np.average(shares, weights=np.maximum(weight, 1e-9))),
        "exact": exact,
    }


def run(files: Sequence[str], out: Path, keys: Mapping[str, str]) -> None:
    """The datasets that are not in the file yet, each added to it as a line.

    Args:
        files: The datasets.
        out: The file.
        keys: How many tosses, of which split, which effects, and how many folds; all tosses, all effects and four if
            they are missing.
    """
    done = [line["data"] for line in lines_so_far(out)]
    which = [f"{key}={keys[key]}" for key in ("split", "tosses", "effects") if key in keys]
    for name in files:
        label = " ".join(["/".join(Path(name).absolute().parts[-2:]), *which])
        if label in done:
            continue
        began, dataset = time.process_time(), read_dataset(name)
        dataset = dataset.split(keys["split"]) if "split" in keys else dataset
        tosses = dataset.tosses[: int(keys.get("tosses", len(dataset.tosses)))]
        part = Dataset(dataset.object, tuple(tosses), dataset.rate_hz, dataset.source, {})
        effects = keys["effects"].split(",") if "effects" in keys else None
        chosen = [each for each in effects_for(dataset.object) if effects is None or each.name in effects]
        found = compare(part, chosen, folds=int(keys.get("folds", 4)), settings=DiagnoseSettings(repeats=0))
        add_line(out, {"data": label, **found, "cpu_s": round(time.process_time() - began, 1)})


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """The lines in Markdown, and how the shares by judging folds differ from the exact ones.

    Args:
        lines: As `run` writes them.
    """
    rows = [
        "| data | tosses | found by all tosses | found without a fold | closed by judging folds [%] | exact [%] |",
        "|---|---|---|---|---|---|",
    ]
    differences, inside = [], 0
    for line in lines:
        value, (low, high) = line["closed"]["value"], line["closed"]["ci95"]
        exact, names = line["exact_closed"], ", ".join(line["named"]) or "nothing"
        without = "; ".join(", ".join(each["named"]) or "nothing" for each in line["exact"])
        same = all(set(each["named"]) == set(line["named"]) for each in line["exact"])
        rows.append(
            f"| {line['data']} | {line['tosses']} | {names} | {'the same' if same else without} | {closed(line)} "
            f"| {100 * exact:.0f} |"
        )
        if line["named"]:
            differences.append(100 * (value - exact))
            inside += low <= exact <= high
    if differences:
        low, middle, high = np.percentile(differences, [10, 50, 90])
        rows += [
            "",
            f"Something was found in {len(differences)} datasets. There judging folds say {middle:.1f} points more "
            f"than the exact share, at the median ({low:.1f} at a tenth of them, {high:.1f} at nine tenths). The exact "
            f"share lies within the interval in {inside}.",
        ]
    return "\n".join(rows)


def main(arguments: list[str]) -> None:
    """Run what is missing, or print a table."""
    keys = dict(each.split("=", 1) for each in arguments if "=" in each)
    if "table" in keys:
        sys.stdout.write(table(read_lines(keys["table"])) + "\n")
        return
    run([each for each in arguments if "=" not in each], Path(keys["out"]), keys)


if __name__ == "__main__":
    main(sys.argv[1:])
