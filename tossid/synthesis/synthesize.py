"""The verb `tossid.synthesize`: tosses from a simulator, with their truth."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import ConfigError, InputError, nearest
from tossid.objects import ObjectModel, load_object, write_object
from tossid.outputs import output_folder
from tossid.settings.changed import changed
from tossid.settings.objects import ObjectSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.store import Dataset, draw_splits, write_dataset
from tossid.store.object_text import text_of_model
from tossid.store.provenance import provenance_of
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.film import film
from tossid.synthesis.tosses import add_noise, make_tosses, with_apparent_phases, world_of
from tossid.types import Progress, Toss, silent

TRUTH = "truth.h5"
"""The true tosses, in a folder that `synthesize` writes."""
TOSSES = "tosses.h5"
"""The measured tosses there, without camera frames."""

DEFAULT = SynthesizeSettings()


def synthesize(
    object: str | Path | ObjectSettings | ObjectModel = "cube",
    *,
    frames: bool = False,
    out: str | Path | None = None,
    settings: SynthesizeSettings = DEFAULT,
    progress: Progress | None = None,
    provenance: Mapping[str, str | int | float | bool] | None = None,
    **keys: Any,
) -> Dataset:
    """Tosses of an object from a simulator, as a sensor would measure them, with their truth.

    Args:
        object: What is tossed: a known name, the path of an MJCF or URDF file, settings, or a loaded object.
        frames: Film the tosses: `out` becomes a recording, for `tossid.ingest`.
        out: A folder to write: the recording, or tosses.h5; and truth.h5. None: nothing is written.
        settings: Engine, world, releases, noise and cameras.
        progress: Called with what is under way, and the share that is done.
        provenance: What the datasets say of their origin in place of, or beside, this call and its settings.
        **keys: Settings by name, such as `tosses=20`, `seed=1`, `engine="lcp"`, `gravity=0.0` or
            `effects={"friction": {"mu": 0.3}}`.

    Returns:
        The measured tosses, with their splits. The exact motions are its `truth`. The dataset does not say which
        effects the simulator had; its truth does. Of filmed tosses: the exact motions alone, on the film's clock.

    Raises:
        ConfigError: A key is no setting, or an effect is beyond the engine.
        InputError: Frames were asked for without a folder, or `out` holds files of other origin.
        DivergedError: A motion became non-finite.
        OutputError: The folder cannot be written.
    """
    model, settings = load_object(object), _with_keys(settings, keys)
    report = progress or silent
    if frames and out is None:
        raise InputError("frames are written to a folder: give out=FOLDER")
    if frames and not model.tags:
        raise ConfigError("object.tags", f"'{model.name}' has no tags that a camera could see; give them.")
    world_of(settings, model)  # refuses what will not do before anything is written
    motion, noise, images = np.random.default_rng(settings.seed).spawn(3)
    with nullcontext() if out is None else output_folder(Path(out), made_by="tossid synthesize") as folder:
        report(f"tossing '{model.name}' {settings.tosses} times with engine {settings.engine.name}", 0.0)
        true, unsolved = make_tosses(settings, model, motion)
        if unsolved:
            warnings.warn(f"the contact problem missed its tolerance in {unsolved} time steps", stacklevel=2)
        lineage = {"unsolved_steps": unsolved, **(provenance or {})}
        if frames and folder is not None:
            true = film(true, model, folder, settings, rng=images, progress=lambda share: report("rendering", share))
        truth = _dataset(model, true, settings, {"covariance_source": "exact states", **lineage})
        found = truth
        if not frames:
            stated = {"covariance_source": "stated by the noise keys", **lineage}
            # what a diagnosis is to find stands in the truth alone
            found = _dataset(model, _measured(true, model, settings, noise), replace(settings, effects={}), stated)
        if folder is not None:
            write_object(model, text_of_model(model), folder)
            write_dataset(truth, folder / TRUTH)
            if not frames:
                write_dataset(found, folder / TOSSES)
        report("done", 1.0)
    return found if frames else replace(found, truth=truth)


def _with_keys(settings: SynthesizeSettings, keys: Mapping[str, Any]) -> SynthesizeSettings:
    """The settings with values by name; an engine may be named instead of given by its settings."""
    engine = keys.get("engine")
    if isinstance(engine, str):
        if engine not in ENGINES:
            problem = f"there is no '{engine}'; expected one of {', '.join(ENGINES)}."
            raise ConfigError("engine", problem, suggestion=nearest(engine, ENGINES))
        settings = replace(settings, engine=ENGINES[engine].settings())
        keys = {name: value for name, value in keys.items() if name != "engine"}
    return changed(settings, keys)


def _measured(
    true: tuple[Toss, ...], model: ObjectModel, settings: SynthesizeSettings, rng: np.random.Generator
) -> tuple[Toss, ...]:
    """The tosses with noise, labels and splits, as a stranger to the simulator would have them."""
    measured = add_noise(true, model, settings.noise, rng)
    if settings.effects:
        measured = with_apparent_phases(measured, model, settings)
    return draw_splits(measured, fractions=settings.splits, seed=settings.seed)


def _dataset(
    model: ObjectModel, tosses: tuple[Toss, ...], settings: SynthesizeSettings, lineage: Mapping[str, Any]
) -> Dataset:
    origin = provenance_of("tossid.synthesize", settings, object=model.name)
    return Dataset(model, tosses, settings.rate_hz, f"synthetic ({settings.engine.name})", {**origin, **lineage})
