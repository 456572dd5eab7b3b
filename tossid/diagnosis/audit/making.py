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

from tossid.diagnosis.audit.cases import Case
from tossid.diagnosis.audit.displacement import motion, strength_reaching
from tossid.diagnosis.audit.over_order import DRIFT, rates, tosses_over_order
from tossid.diagnosis.audit.unknown_forces import UNKNOWN_FORCES, push_of
from tossid.motion import label_phases
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.physics.effects.strength import Values
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.ingestion import IngestSettings
from tossid.settings.synthesis import Engine, LcpEngine, NoiseSettings, SynthesizeSettings
from tossid.store import write_tum
from tossid.store.importers import TumSource
from tossid.synthesis.engines import ENGINES
from tossid.synthesis.film import film
from tossid.synthesis.tosses import add_noise, draw_releases, frames_until_rest, make_tosses
from tossid.types import Toss
from tossid.vision.ingest import ingest_source
from tossid.vision.recordings.formats.frames import FramesSource

TOSSES = "tosses.h5"
"""The dataset that a diagnosis gets, in a case's folder."""


def make_case(case: Case, model: ObjectModel, settings: AuditSettings, folder: Path) -> dict[str, Any]:
    """Write a case's tosses: tosses.h5, and `tum/` from which it is read. A film is not kept.

    Args:
        case: The case.
        model: What is tossed.
        settings: How many tosses, their noise, and how they are simulated.
        folder: Where to.

    Returns:
        The truth: `case`, `effects` (values by effect and parameter) and `displacement` (what each reaches, over the
        position noise); of a drift `rates`, the change of each value from toss to toss.
    """
    synthesis = _synthesis(case, settings)
    effects, reached = _strengths(case, model, settings, synthesis)
    motions, noise = np.random.default_rng([case.seed, 5]).spawn(2)
    if case.order is not None:
        tosses = tosses_over_order(effects, case.order, model, synthesis, motions)
    elif set(effects) & set(UNKNOWN_FORCES):
        ((name, values),) = effects.items()
        tosses = _pushed_tosses(name, values, case, model, synthesis, settings, motions)
    else:
        tosses, _ = make_tosses(replace(synthesis, effects=effects), model, motions)
    _record(tosses, case, model, settings, synthesis, noise, folder)
    truth = {"case": case.as_json(), "effects": effects, "displacement": reached}
    if case.order is None or case.order.form != DRIFT:
        return truth
    return {**truth, "rates": rates(effects, World(model, gravity=synthesis.gravity), settings.tosses)}


def _record(
    tosses: Sequence[Toss],
    case: Case,
    model: ObjectModel,
    settings: AuditSettings,
    synthesis: SynthesizeSettings,
    rng: np.random.Generator,
    folder: Path,
) -> None:
    """Write true tosses to a case's folder as they are recorded."""
    # (the diagnosis shall find what the ingest would level)
    as_recorded = IngestSettings(level="never" if settings.filmed or case.order is not None else "auto")

    def ingest(source: Any) -> None:
        ingest_source(source, object=model, settings=as_recorded, out=folder / TOSSES, progress=lambda progress: None)

    if settings.filmed:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            film(tosses, model, Path(place), replace(synthesis, seed=case.seed), rng=rng)
            ingest(FramesSource(path=Path(place)))
        return
    stated = NoiseSettings(
        position=settings.position_noise, rotation=settings.rotation_noise, joint=settings.rotation_noise
    )
    write_tum(folder / "tum", add_noise(tosses, model, stated, rng))
    ingest(TumSource(path=folder / "tum"))


def _synthesis(case: Case, settings: AuditSettings) -> SynthesizeSettings:
    """How a case is simulated: in far shorter steps than a diagnosis takes, whose errors it must not share."""
    engine: Engine = ENGINES[case.engine].settings()
    if isinstance(engine, LcpEngine):
        engine = replace(engine, substeps=settings.making.lcp_substeps)
    return SynthesizeSettings(engine=engine, tosses=settings.tosses)


def _strengths(
    case: Case, model: ObjectModel, settings: AuditSettings, synthesis: SynthesizeSettings
) -> tuple[dict[str, Values], dict[str, float]]:
    """Values of the case's effects, and the displacements over the noise that they reach."""
    making = settings.making
    throws = draw_releases(
        model,
        synthesis.release,
        making.throws,
        gravity=synthesis.gravity,
        rng=np.random.default_rng([case.seed, 4]),
    )
    effects, reached = {}, {}
    for i, (name, target) in enumerate(zip(case.effects, case.targets, strict=True)):
        effects[name], reached[name] = strength_reaching(
            name,
            target,
            World(model, gravity=synthesis.gravity),
            *throws,
            noise=settings.position_noise,
            n_steps=round(making.seconds * synthesis.rate_hz),
            dt=1 / synthesis.rate_hz,
            seed=case.seed + i,
            settings=making,
        )
    return effects, reached


def _pushed_tosses(
    name: str,
    values: Values,
    case: Case,
    model: ObjectModel,
    synthesis: SynthesizeSettings,
    settings: AuditSettings,
    rng: np.random.Generator,
) -> tuple[Toss, ...]:
    """Tosses under a force that the library does not have, otherwise as `make_tosses` makes them."""
    n, rate = synthesis.tosses, synthesis.rate_hz
    q0, v0 = draw_releases(model, synthesis.release, n, gravity=synthesis.gravity, rng=rng)
    push = push_of(name, values, count=n, seconds=synthesis.seconds, seed=case.seed)
    world, n_steps = World(model, gravity=synthesis.gravity), round(synthesis.seconds * rate)
    q, v = motion(world, q0, v0, n_steps=n_steps, dt=1 / rate, push=push, settings=settings.making)
    tosses = []
    for i in range(n):
        length = frames_until_rest(model, q[i], v[i], synthesis)
        t, exact = np.arange(length) / rate, np.tile(1e-12 * np.eye(model.nv), (length, 1, 1))
        phase = label_phases(model, t, q[i, :length], v[i, :length], gravity=synthesis.gravity)
        tosses.append(Toss(f"{i:0{len(str(n - 1))}d}", t, q[i, :length], v[i, :length], exact, exact, phase))
    return tuple(tosses)
