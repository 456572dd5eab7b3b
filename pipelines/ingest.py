"""`tossid ingest`: raw recordings, tracked poses or published tosses to a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.outputs import output_file
from pipelines.project import DATASETS, check_dataset_name, load_object, object_named
from pipelines.schemas import ContactNetsSource, IngestConfig, PllSource, TumSource
from tossid.errors import FileError

if TYPE_CHECKING:
    from tossid.motion import Defect
    from tossid.objects import ObjectModel
    from tossid.types import PoseTrack


def run(config: IngestConfig, console: Console) -> dict[str, Any]:
    """Read the source, write the dataset; returns what `info` says of it, and `out`."""
    if isinstance(config.source, ContactNetsSource | PllSource | TumSource):
        return _import(config, config.source, console)
    from pipelines.frames import ingest_frames

    return ingest_frames(config, config.source, console)


def _import(
    config: IngestConfig, source: ContactNetsSource | PllSource | TumSource, console: Console
) -> dict[str, Any]:
    """Published tosses or tracked poses."""
    path = source.path
    if not path.is_dir():
        raise FileError(path, "no such folder; source.path names the folder of tosses")
    out = check_dataset_name("out", config.out or DATASETS / f"{path.resolve().name}.h5")
    model = load_object(config.object or object_named("elbow" if isinstance(source, PllSource) else "cube"))

    from pipelines.datasets import described, provenance
    from tossid.motion import covariance_source, find_defects, tosses_in_turn
    from tossid.store import dataset_writer, drawn_splits, source_sha256

    with output_file(out) as temporary, dataset_writer(model, temporary) as writer:
        console.say(f"{path}: reading tosses of '{model.name}'")
        tracks, rate_hz = _read(source, model)
        console.say(f"{path}: {len(tracks)} tosses, {sum(len(track.t) for track in tracks)} frames")
        names: list[str] = []
        defects: list[Defect] = []
        with console.progress("velocities and phases", len(tracks), unit="tosses") as progress:
            for toss in tosses_in_turn(tracks, model, gravity=config.gravity, end_at_rest=source.name == "tum"):
                writer.add(toss)
                names.append(toss.name)
                defects += find_defects([toss], model, gravity=config.gravity)
                progress.advance()
        if defects:
            _say_defects(config, defects, len(tracks), console)
        aside = {defect.toss for defect in defects} if config.defects == "set_aside" else set()
        sound = [name for name in names if name not in aside]
        lineage = {
            "source_path": str(path),
            "source_sha256": source_sha256(path),
            "covariance_source": covariance_source(tracks),
            "defects": "; ".join(f"{d.toss}: {d.rule} {d.value:.1f}" for d in defects),
        }
        writer.finish(
            rate_hz=rate_hz,
            source=source.name,
            provenance=provenance("ingest", config, lineage),
            splits=drawn_splits(sound, fractions=config.splits, seed=config.seed),
        )
    return described(out, console)


def _say_defects(config: IngestConfig, defects: Sequence[Defect], n_tosses: int, console: Console) -> None:
    """Which rules how many tosses break, and what becomes of them."""
    from tossid.motion.defects import RULES

    counts = {rule: sum(defect.rule == rule for defect in defects) for rule in RULES}
    said = ", ".join(f"{rule} {count}" for rule, count in counts.items() if count)
    n = len({defect.toss for defect in defects})
    done = "left out of the splits" if config.defects == "set_aside" else "kept; defects=set_aside leaves them out"
    console.warn(f"{n} of {n_tosses} tosses have defects ({said}): {done}")


def _read(source: ContactNetsSource | PllSource | TumSource, model: ObjectModel) -> tuple[Sequence[PoseTrack], float]:
    """The source's tracks, and their rate [Hz]."""
    from tossid import store
    from tossid.motion import median_rate

    if isinstance(source, ContactNetsSource):
        return store.read_contactnets(source.path, half_width=source.half_width, rate_hz=source.rate_hz), source.rate_hz
    if isinstance(source, PllSource):
        return store.read_pll(source.path, n_joints=model.n_joints, rate_hz=source.rate_hz), source.rate_hz
    tracks = store.read_tum(source.path, n_joints=model.n_joints)
    return tracks, median_rate(tracks)
