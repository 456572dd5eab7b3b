"""`tossid diagnose`: where a simulator misses the tosses, which effect causes it, how far that closes the gap."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.project import dataset_path
from pipelines.schemas import DiagnoseConfig, MjcfSim, NominalSim
from tossid.errors import ConfigError, InputError, TossidError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tossid.diagnosis.engines import Engine
    from tossid.diagnosis.findings import Diagnosis
    from tossid.objects import ObjectModel
    from tossid.physics.effects import Effect, World
    from tossid.types import Dataset, Toss

FOLDER = Path("outputs/diagnose")
FEWEST_TOSSES = 6
"""Fewer than this leave halves of which neither fits nor judges."""


@dataclass(frozen=True)
class Simulator:
    """What is judged. about: in words. mjcf: the user's own file, engine: as MuJoCo runs it. run: id of the run."""

    world: World
    about: str
    mjcf: Path | None = None
    run: str | None = None
    engine: Engine | None = None


def run(config: DiagnoseConfig, console: Console) -> dict[str, Any]:
    """Diagnose; returns gap.json's content, and where the report lies."""
    from pipelines.calling import jsonable
    from pipelines.outputs import output_folder
    from pipelines.tracking import tracked_run
    from tossid.diagnosis.attribution import diagnose
    from tossid.store import file_sha256, read_dataset

    data = dataset_path(config.data)
    dataset, sha256 = read_dataset(data), file_sha256(data)
    threads = config.threads or os.cpu_count() or 1
    library = _library(config, dataset.object)
    simulator = _simulator(config, dataset.object)
    tosses, unseen = _chosen(config, dataset)
    tosses, remarks = _usable(tosses, _whose(config, data), console)
    tosses, lost = _survived(simulator, dataset.object, tosses, data, threads=threads)
    remarks += lost
    for text in lost:
        console.warn(text)
    folder = config.out or FOLDER / f"{_dataset_name(data)}-{config.sim.name}"
    with (
        output_folder(folder, made_by="tossid diagnose") as temporary,
        tracked_run(folder.name, config, command="diagnose") as tracked,
    ):
        tracked.data(data, sha256, context="diagnosis")
        with console.progress(f"diagnosing {simulator.about}", 100, unit="%") as bar:
            done = 0.0

            def progress(text: str, share: float) -> None:
                nonlocal done
                bar.advance(max(0.0, 100 * share - done), note=text)
                done = max(done, 100 * share)

            found = diagnose(
                tosses,
                simulator.world,
                library=library,
                engine=simulator.engine,
                n_threads=threads,
                seed=config.seed,
                unseen=unseen,
                progress=progress,
            )
            if found.contact == "relaxed" and simulator.mjcf is None:
                remarks.append(
                    "Friction is taken as MuJoCo has it (relaxed: what slides lifts off); these tosses follow it more "
                    "than Coulomb's law."
                )
            if found.contact != "own" and simulator.mjcf is not None:
                remarks.append(
                    "Contact is taken as rigid; these tosses follow that more than your model's own contact. The patch "
                    "makes it so (solref, solimp, a shorter time step and an elliptic cone)."
                )
            progress("next toss and patch", 0.95)
            extra = _beside(config, found, simulator, tosses, dataset.object, threads, console)
            progress("report", 0.99)
            gap = {
                **found.as_json(),
                **extra,
                "simulator": {"sim": config.sim.name, "about": simulator.about, "run": simulator.run},
                "data": {"path": str(data), "sha256": sha256, "object": dataset.object.name},
                "remarks": remarks,
            }
            figures = _write(temporary, gap, found, _whose(config, data), simulator, remarks)
            progress("done", 1.0)
        tracked.metrics(_metrics(found))
        tracked.tag("verdict", found.verdict)
        tracked.tag("effects", ", ".join(found.named))
        for name in ("gap.json", "gap.html", "figures"):
            tracked.artifact(temporary / name)
        if (temporary / "patched.xml").is_file():
            tracked.artifact(temporary / "patched.xml")
    _say(found, gap, folder, console)
    where: dict[str, Any] = {
        "out": str(folder),
        "report": str(folder / "gap.html"),
        "gap_json": str(folder / "gap.json"),
        "figures": [str(folder / "figures" / name) for name in figures],
        "run": tracked.id,
    }
    if gap["patch"].get("mjcf"):
        where["patched_mjcf"] = str(folder / "patched.xml")
    plain: dict[str, Any] = jsonable(gap)
    return {**plain, **where}


# ---------------------------------------------------------------- what is judged, and on what


def _library(config: DiagnoseConfig, recorded: ObjectModel) -> tuple[Effect, ...]:
    from pipelines.keys import nearest
    from tossid.physics.effects import library_for

    library = library_for(recorded)
    names = [effect.name for effect in library]
    for name in config.without:
        if name not in names:
            raise ConfigError("without", f"there is no effect '{name}'.", suggestion=nearest(name, names))
    return tuple(effect for effect in library if effect.name not in config.without)


def _simulator(config: DiagnoseConfig, recorded: ObjectModel) -> Simulator:
    from tossid.physics.effects import World

    sim = config.sim
    if isinstance(sim, NominalSim):
        return Simulator(World(recorded, gravity=sim.gravity), f"the stated '{recorded.name}', rigid")
    if isinstance(sim, MjcfSim):
        from tossid.diagnosis.simulators import world_of_mjcf

        try:
            world, engine = world_of_mjcf(sim.path, width=recorded.width)
        except InputError as error:
            raise InputError(f"sim.path: {error}") from error
        return Simulator(world, f"the MuJoCo model {sim.path}", mjcf=sim.path, engine=engine)
    from pipelines.checkpoints import load_checkpoint
    from pipelines.runs import find_run
    from tossid.diagnosis.simulators import world_of_model

    record = find_run(sim.path)
    if record.checkpoint is None:
        raise InputError(f"run {record.name} ({record.id or record.folder}) has no checkpoint")
    about = f"run {record.name}" + (f" ({record.id[:8]})" if record.id else "")
    world = world_of_model(load_checkpoint(record.checkpoint).model)
    return Simulator(world, about, run=record.id or None)


def _chosen(config: DiagnoseConfig, dataset: Dataset) -> tuple[tuple[Toss, ...], tuple[Toss, ...]]:
    """The tosses that are diagnosed, and those of the test split, if others are."""
    tosses = tuple(dataset.tosses) if config.split is None else dataset.of_split(config.split)
    last = None if config.tosses is None else config.skip + config.tosses
    unseen = () if config.split in (None, "test") else _lasting(dataset.of_split("test"))[1]
    return tosses[config.skip : last], unseen


def _whose(config: DiagnoseConfig, data: Path) -> str:
    """The tosses in words: the dataset, and which of it."""
    which = [] if config.split is None else [f"{config.split} split"]
    if config.skip or config.tosses:
        which.append(f"from number {config.skip + 1}")
    return f"{data}, {', '.join(which)}" if which else str(data)


def _lasting(tosses: tuple[Toss, ...]) -> tuple[tuple[Toss, ...], tuple[Toss, ...]]:
    """Tosses that are long enough to predict from, and those of them in which anything moves."""
    from tossid.diagnosis.simulators import moves
    from tossid.diagnosis.windows import LENGTH

    long = tuple(toss for toss in tosses if len(toss) > LENGTH // 2)
    return long, tuple(toss for toss in long if moves(toss))


def _usable(tosses: tuple[Toss, ...], of: str, console: Console) -> tuple[tuple[Toss, ...], list[str]]:
    """Tosses that are long enough to predict from, and in which anything moves; and what is said of the others.

    Raises:
        InputError: fewer than `FEWEST_TOSSES`.
    """
    from tossid.diagnosis.windows import LENGTH

    least = LENGTH // 2 + 1
    long, kept = _lasting(tosses)
    why = []
    if len(long) < len(tosses):
        why.append(f"{len(tosses) - len(long)} of {len(tosses)} are shorter than {least} frames")
    if len(kept) < len(long):
        why.append(f"in {len(long) - len(kept)} of {len(tosses)} nothing moves")
    if len(kept) < FEWEST_TOSSES:
        which = f" that serve ({', '.join(why)})" if why else ""
        raise InputError(
            f"{of}: has {len(kept)} tosses{which}; a diagnosis needs at least {FEWEST_TOSSES}, to fit effects to "
            "some and judge them on others"
        )
    if not why:
        return kept, []
    console.warn(f"tosses left out: {', '.join(why)}")
    return kept, [f"Tosses left out: {', '.join(why)}."]


def _survived(
    simulator: Simulator, recorded: ObjectModel, tosses: tuple[Toss, ...], data: Path, *, threads: int
) -> tuple[tuple[Toss, ...], list[str]]:
    """The tosses, after the simulator has shown that it is of the same object and survives them."""
    from tossid.diagnosis.simulators import check_runs, check_same_object

    check_same_object(simulator.world, recorded, where=str(data))
    lost = check_runs(simulator.world, tosses, where=simulator.about, n_threads=threads)
    return tosses, [
        f"The simulator diverges on {len(lost)} of {len(tosses)} tosses: {', '.join(lost)}."
    ] if lost else []


def _dataset_name(data: Path) -> str:
    """ "cube" for data/datasets/cube.h5, "cube-lcp-0" for data/raw/cube-lcp-0/tosses.h5"""
    return data.resolve().parent.name if data.name == "tosses.h5" else data.stem


# ---------------------------------------------------------------- what stands beside the diagnosis


def _beside(
    config: DiagnoseConfig,
    found: Diagnosis,
    simulator: Simulator,
    tosses: tuple[Toss, ...],
    recorded: ObjectModel,
    threads: int,
    console: Console,
) -> dict[str, Any]:
    """gap.json's next_toss and patch."""
    import numpy as np

    from tossid.diagnosis.next_toss import next_toss
    from tossid.diagnosis.patch import make_patch
    from tossid.diagnosis.patch_rerun import rerun

    following = next_toss(
        found.hypothesis,
        found.alternatives,
        tosses,
        recorded,
        rng=np.random.default_rng(config.seed),
        n_threads=threads,
    )
    rigid = simulator.mjcf is not None and found.contact != "own"
    patch = make_patch(found.hypothesis, mjcf=simulator.mjcf, rigid=rigid)
    report: dict[str, Any] = patch.as_json()
    report["rerun"] = None
    if patch.changes or patch.recording or simulator.mjcf is not None:
        try:
            report["rerun"] = rerun(patch, found.hypothesis, tosses, recorded, n_threads=threads)
        except TossidError as error:
            console.warn(f"the patch was not rerun in MuJoCo: {error}")
            report["rerun"] = {"problem": str(error)}
    return {"next_toss": following, "patch": report}


def _write(
    folder: Path,
    gap: dict[str, Any],
    found: Diagnosis,
    of: str,
    simulator: Simulator,
    remarks: list[str],
) -> list[str]:
    """gap.json, gap.html, the figures and the patched MJCF; returns the figures' names."""
    from pipelines.calling import jsonable
    from pipelines.pictures import write_figures
    from tossid.diagnosis.figures import report_figures
    from tossid.diagnosis.place_figures import place_figures
    from tossid.diagnosis.report import report_html

    figures: dict[str, Figure] = report_figures(found)
    details: dict[str, Figure] = place_figures(found)
    about = f"Simulator: {simulator.about}. Tosses: {found.n_tosses} of {of}."
    page = report_html(
        found,
        figures,
        about=about,
        details=details,
        patch=gap["patch"],
        next_toss=gap["next_toss"],
        remarks=remarks,
    )
    (folder / "gap.html").write_text(page)
    (folder / "gap.json").write_text(json.dumps(jsonable(gap), indent=2, allow_nan=False) + "\n")
    if gap["patch"].get("mjcf"):
        (folder / "patched.xml").write_text(gap["patch"]["mjcf"])
    return [path.name for path in write_figures(figures | details, folder / "figures")]


def _metrics(found: Diagnosis) -> dict[str, float]:
    """What is tracked: the gap, how much of it is closed, the last rollouts' errors."""
    numbers = {
        "gap_total": found.gap.total.value,
        "gap_left": found.left.total.value,
        "noise_floor": found.gap.noise_floor,
        "gap_closed": found.gap_closed.value,
        "n_effects": float(len(found.named)),
        "seconds": found.seconds,
    }
    for when, step in (("before", found.steps[:1]), ("after", found.steps[-1:])):
        for each in step:
            numbers[f"position_error_pct/{when}"] = each.position_error_pct.value
            numbers[f"rotation_error_deg/{when}"] = each.rotation_error_deg.value
    for finding in found.findings:
        if finding.name in found.named:
            numbers |= {f"{finding.name}/{key}": value.value for key, value in finding.parameters.items()}
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


def _say(found: Diagnosis, gap: dict[str, Any], folder: Path, console: Console) -> None:
    """The verdict in words, the effects in a table."""
    from tossid.diagnosis.words import closes, headline, in_units, parameter, sentences, verdict_of

    console.say(headline(found))
    for text in sentences(found):
        console.say(f"  {text}")
    shown = [f for f in found.findings if f.verdict in ("identified", "confusable")]
    rows = [
        [
            f.name,
            ", ".join(f"{parameter(k)} {in_units(k, v)}" for k, v in f.parameters.items()),
            closes(f.gap_closed),
            verdict_of(f),
        ]
        for f in shown
    ]
    if rows:
        console.table(["effect", "found (95 % interval)", "closes", "verdict"], rows)
    release = gap["next_toss"].get("release")
    if release:
        console.say(f"next toss: see {folder / 'gap.html'}")
    console.say(f"report: {folder / 'gap.html'}")
