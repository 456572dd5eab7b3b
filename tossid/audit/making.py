"""The tosses of a case: simulated with its effects, recorded, and read back as a dataset.

They are recorded as TUM files of poses with normal noise, or as a film in which tags are tracked. What a diagnosis then
gets has passed through files that hold poses or images only, so that it cannot know the effect.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.audit.cases import Case
from tossid.audit.displacement import SECONDS, THROWS, motion, strength_reaching
from tossid.audit.unknown_forces import UNKNOWN_FORCES, push_of
from tossid.ingestion.ingest import ingest_source
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.strength import Values
from tossid.settings.audit import AuditSettings
from tossid.settings.ingestion import IngestSettings
from tossid.settings.synthesis import Engine, LcpEngine, NoiseSettings, SynthesizeSettings
from tossid.store import write_tum
from tossid.store.importers import TumSource
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.film import film
from tossid.synthesis.tosses import add_noise, draw_releases, frames_until_rest, make_tosses
from tossid.types import Toss
from tossid.vision.recordings.formats.frames import FramesSource

TOSSES = "tosses.h5"
"""The dataset that a diagnosis gets, in a case's folder."""
LCP_SUBSTEPS = 64
"""Time steps a frame of the engine lcp: far more than a diagnosis takes, whose errors the truth must not share."""


def make_case(case: Case, model: ObjectModel, settings: AuditSettings, folder: Path) -> dict[str, Any]:
    """Write a case's tosses: tosses.h5, and `tum/` from which it is read. A film is not kept.

    Args:
        case: The case.
        model: What is tossed.
        settings: How many tosses, their noise, and how they are simulated.
        folder: Where to.

    Returns:
        The truth: `case`, `effects` (values by effect and parameter) and `displacement` (what each reaches, over the
        position noise).
    """
    effects, reached = strengths_of(case, model, settings)
    synthesis = synthesis_of(case, settings)
    motions, noise = np.random.default_rng([case.seed, 5]).spawn(2)
    if set(effects) & set(UNKNOWN_FORCES):
        ((name, values),) = effects.items()
        tosses = _pushed_tosses(name, values, case, model, synthesis, motions)
    else:
        tosses, _ = make_tosses(replace(synthesis, effects=effects), model, motions)
    record(tosses, model, settings, noise, folder, film_as=replace(synthesis, seed=case.seed))
    return {"case": case.as_json(), "effects": effects, "displacement": reached}


def synthesis_of(case: Case, settings: AuditSettings) -> SynthesizeSettings:
    """How a case is simulated: in far shorter steps than a diagnosis takes, whose errors it must not share.

    Args:
        case: The case.
        settings: How many tosses.
    """
    engine: Engine = ENGINES[case.engine].settings()
    if isinstance(engine, LcpEngine):
        engine = replace(engine, substeps=LCP_SUBSTEPS)
    return SynthesizeSettings(engine=engine, tosses=settings.tosses)


def strengths_of(case: Case, model: ObjectModel, settings: AuditSettings) -> tuple[dict[str, Values], dict[str, float]]:
    """Values of the case's effects, and the displacements over the noise that they reach.

    Args:
        case: The case.
        model: What is tossed.
        settings: The noise.
    """
    synthesis = synthesis_of(case, settings)
    drawn = np.random.default_rng([case.seed, 4])
    throws = draw_releases(model, synthesis.release, THROWS, gravity=synthesis.gravity, rng=drawn)
    effects, reached = {}, {}
    for i, (name, target) in enumerate(zip(case.effects, case.targets, strict=True)):
        effects[name], reached[name] = strength_reaching(
            name,
            target,
            World(model, gravity=synthesis.gravity),
            *throws,
            noise=settings.position_noise,
            n_steps=round(SECONDS * synthesis.rate_hz),
            dt=1 / synthesis.rate_hz,
            seed=case.seed + i,
        )
    return effects, reached


def record(
    tosses: Sequence[Toss],
    model: ObjectModel,
    settings: AuditSettings,
    rng: np.random.Generator,
    folder: Path,
    *,
    film_as: SynthesizeSettings = SynthesizeSettings(),
) -> None:
    """Write true tosses to a folder as they are recorded, and the dataset that is ingested from that.

    Args:
        tosses: The tosses.
        model: What is tossed.
        settings: Their noise, and whether they are filmed.
        rng: Draws the noise.
        folder: Where to.
        film_as: Cameras and light, where they are filmed.
    """

    def ingest(source: Any) -> None:
        how = IngestSettings(level="never")  # (a diagnosis cannot find what ingest undoes)
        ingest_source(source, object=model, settings=how, out=folder / TOSSES, progress=lambda progress: None)

    if settings.filmed:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            film(tosses, model, Path(place), film_as, rng=rng)
            ingest(FramesSource(path=Path(place)))
        return
    rotation = settings.rotation_noise
    stated = NoiseSettings(position=settings.position_noise, rotation=rotation, joint=rotation)
    write_tum(folder / "tum", add_noise(tosses, model, stated, rng))
    ingest(TumSource(path=folder / "tum"))


def _pushed_tosses(
    name: str,
    values: Values,
    case: Case,
    model: ObjectModel,
    synthesis: SynthesizeSettings,
    rng: np.random.Generator,
) -> tuple[Toss, ...]:
    """Tosses under a force that the library does not have, otherwise as `make_tosses` makes them."""
    n, rate = synthesis.tosses, synthesis.rate_hz
    q0, v0 = draw_releases(model, synthesis.release, n, gravity=synthesis.gravity, rng=rng)
    push = push_of(name, values, count=n, seconds=synthesis.seconds, seed=case.seed)
    world, n_steps = World(model, gravity=synthesis.gravity), round(synthesis.seconds * rate)
    q, v = motion(world, q0, v0, n_steps=n_steps, dt=1 / rate, push=push)
    tosses = []
    for i in range(n):
        length = frames_until_rest(model, q[i], synthesis)
        t, exact = np.arange(length) / rate, np.tile(1e-12 * np.eye(model.nv), (length, 1, 1))
        phase = label_phases(model, t, q[i, :length], v[i, :length], gravity=synthesis.gravity)
        tosses.append(Toss(f"{i:0{len(str(n - 1))}d}", t, q[i, :length], v[i, :length], exact, exact, phase))
    return tuple(tosses)
