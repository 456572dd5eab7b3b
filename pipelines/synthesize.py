"""`tossid synthesize`: tosses from a simulator, as camera frames or as states, with their truth beside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipelines.console import Console
from pipelines.datasets import provenance
from pipelines.outputs import output_folder
from pipelines.project import RECORDINGS, load_object, write_object
from pipelines.schemas import SynthesizeConfig
from pipelines.tossing import add_noise, label_as_seen, make_tosses, world_of
from tossid.errors import ConfigError
from tossid.store import draw_splits, file_sha256, write_dataset
from tossid.types import Dataset

if TYPE_CHECKING:
    from tossid.objects import ObjectModel
    from tossid.types import Toss

TRUTH = "truth.h5"
TOSSES = "tosses.h5"


def run(config: SynthesizeConfig, console: Console) -> dict[str, Any]:
    """Simulate, then write frames or states; returns what was made."""
    model = load_object(config.object)
    if config.frames and not model.tags:
        raise ConfigError(
            "object.tags", f"'{model.name}' has no tags that a camera could see; give them, or frames=false."
        )
    if config.effects:
        world_of(config, model)  # refuses what will not do, before anything is written
    out = config.out or RECORDINGS / f"{config.object.name}-{config.engine.name}-{config.seed}"
    motion, noise, images = np.random.default_rng(config.seed).spawn(3)
    with output_folder(out, made_by="tossid synthesize") as folder:
        console.say(f"tossing '{model.name}' {config.tosses} times with engine {config.engine.name}")
        if config.effects:
            console.say(f"effects: {', '.join(config.effects)}")
        tosses, unsolved = make_tosses(config, model, motion)
        if unsolved:
            console.warn(f"the contact problem missed its tolerance in {unsolved} time steps")
        if config.frames:
            from pipelines.filming import film

            made = film(config, model, tosses, folder, images, console)
            tosses = made.tosses
            facts = {"n_images": made.n_images, "cameras": made.cameras}
        else:
            seen = add_noise(tosses, model, config.noise, noise)
            if config.effects:
                seen = label_as_seen(seen, model, config)
            seen = draw_splits(seen, fractions=config.splits, seed=config.seed)
            # what a diagnosis is to find stands in the truth alone
            _save(replace(config, effects={}), seen, model, folder / TOSSES, unsolved)
            facts = {"dataset": str(out / TOSSES), "n_images": 0}
        write_object(config.object, folder)
        _save(config, tosses, model, folder / TRUTH, unsolved)
    result = {
        "out": str(out),
        "object": model.name,
        "engine": config.engine.name,
        "n_tosses": len(tosses),
        "n_frames": sum(len(toss) for toss in tosses),
        "rate_hz": config.rate_hz,
        "seed": config.seed,
        "unsolved_steps": unsolved,
        "truth": str(out / TRUTH),
        "truth_sha256": file_sha256(out / TRUTH),
        **facts,
    }
    console.facts(result, title=f"wrote {out}")
    then = "tossid ingest" if config.out is None else f"tossid ingest source.path={out}"
    console.say(f"next: {then}" if config.frames else f"next: tossid train data={out / TOSSES}")
    return result


def _save(config: SynthesizeConfig, tosses: tuple[Toss, ...], model: ObjectModel, path: Path, unsolved: int) -> None:
    lineage = {
        "covariance_source": "stated by the noise keys" if path.name == TOSSES else "exact states",
        "unsolved_steps": unsolved,
    }
    source = f"synthetic ({config.engine.name})"
    write_dataset(Dataset(model, tosses, config.rate_hz, source, provenance("synthesize", config, lineage)), path)
