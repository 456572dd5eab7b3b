"""How far judging folds, as every diagnosis has them, are from a search repeated without each fold.

    python -m pipelines.tools.experiments.nested [folds=4] [tosses=16] [effects=friction,gravity] FILE.h5 ...

For each dataset: the share of the gap that a diagnosis reports as closed, and the share that is closed when the whole
search is repeated on the tosses outside of each fold and judged on that fold in one pass (`explain(unseen=...)`). The
second is exact: neither choice nor fit, whitening or slow errors have seen the tosses that judge. It costs as many
searches as there are folds.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

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
    closed = [each["gap_closed"]["value"] for each in exact]
    weight = [each["n_tosses"] * (each["gap"]["value"] ** 2 - 1.0) for each in exact]
    return {
        "tosses": len(tosses),
        "named": list(whole.found),
        "closed": whole.gap_closed.as_json(),
        "seconds": whole.seconds,
        "exact_closed": float(np.average(closed, weights=np.maximum(weight, 1e-9))),
        "exact": exact,
    }


def main(arguments: list[str]) -> None:
    """One JSON line a dataset."""
    keys = dict(each.split("=", 1) for each in arguments if "=" in each)
    for name in (each for each in arguments if "=" not in each):
        began = time.perf_counter()
        dataset = read_dataset(name)
        tosses = dataset.tosses[: int(keys.get("tosses", len(dataset.tosses)))]
        part = Dataset(dataset.object, tuple(tosses), dataset.rate_hz, dataset.source, {})
        effects = keys["effects"].split(",") if "effects" in keys else None
        library = effects_for(dataset.object)
        chosen = [effect for effect in library if effects is None or effect.name in effects]
        found = compare(part, chosen, folds=int(keys.get("folds", 4)))
        line = {"data": Path(name).name, **found, "all_seconds": time.perf_counter() - began}
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
