"""`tossid diagnose`: finds the dataset and the simulator, and saves, tracks and prints what `tossid.diagnose` finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.cli.console import Console
from pipelines.cli.failures import Interrupted, was_interrupted
from pipelines.config.schemas import DiagnoseConfig, MjcfSim, NominalSim, PythonSim, RunSim
from pipelines.files.project import dataset_path
from tossid.errors import InputError

if TYPE_CHECKING:
    from tossid.diagnosis.result import Diagnosis
    from tossid.diagnosis.simulators import Simulator
    from tossid.objects import ObjectModel

FOLDER = Path("outputs/diagnose")


def run(config: DiagnoseConfig, console: Console) -> dict[str, Any]:
    """Diagnose; returns gap.json's content, and where the report lies."""
    from pipelines.tracking.run import tracked_run
    from tossid.diagnosis.diagnose import prepare
    from tossid.diagnosis.under_way import UnderWay
    from tossid.outputs import output_folder
    from tossid.plain_json import jsonable
    from tossid.store import file_sha256, read_dataset

    data = dataset_path(config.data)
    dataset, sha256 = read_dataset(data), file_sha256(data)
    simulator = _SIMULATORS[config.sim.name](config.sim, dataset.object)
    about = {"path": str(data), "sha256": sha256, "object": dataset.object.name}
    task = prepare(dataset, simulator, settings=config, name=str(data), data=about)
    for remark in task.about["remarks"]:
        console.warn(remark)
    folder = config.out or FOLDER / f"{_dataset_name(data)}-{config.sim.name}"
    under_way = UnderWay(news=console.say)
    found: Diagnosis | None = None
    try:
        with console.shares(f"diagnosing {simulator.about}") as progress:
            under_way.progress = progress
            task.gap_of_first(under_way)  # before the tracker, which takes a second to open
            with tracked_run(folder.name, config, command="diagnose") as tracked:
                tracked.data(data, sha256, context="diagnosis")
                with output_folder(folder, made_by="tossid diagnose") as temporary:
                    found = task.run(under_way)
                    found.save(temporary)
                tracked.metrics(found.metrics())
                tracked.describe(f"The whole report is `gap.html`, under Artifacts.\n\n```\n{found}\n```")
                tracked.tag("verdict", found.verdict)
                tracked.tag("effects", ", ".join(found.named))
                written = [name for name in _FILES if (folder / name).exists()]
                for name in written:
                    tracked.artifact(folder / name)
    except BaseException as error:
        if under_way.first is None or not was_interrupted(error):
            raise
        found = None
    if found is None:  # out of the handler, so that an error here is no interrupt
        raise Interrupted(_save_so_far(task.known_so_far(under_way), folder, console))
    for remark in found.remarks:
        if remark not in task.about["remarks"]:
            console.say(remark)
    _say(found, folder, console)
    where = {_FILES[name]: str(folder / name) for name in written if _FILES[name]}
    where |= {"out": str(folder), "run": tracked.id}
    plain: dict[str, Any] = jsonable(found.as_json())
    return {**plain, **where, "figures": sorted(str(path) for path in (folder / "figures").iterdir())}


def _save_so_far(found: Diagnosis, folder: Path, console: Console) -> str:
    """Save what was known when the command was interrupted, beside an earlier report; says where it is."""
    from tossid.outputs import output_folder

    if folder.exists():
        folder = folder.with_name(f"{folder.name}-interrupted")
    with output_folder(folder, made_by="tossid diagnose") as temporary:
        found.save(temporary)
    _say(found, folder, console)
    return f"what was known by then is in {folder / 'gap.html'}"


_FILES = {"gap.json": "gap_json", "gap.html": "report", "patched.xml": "patched_mjcf", "figures": "", "assets": ""}
"""What may be written, and the key under which the command says where; what has none is only logged."""


def _nominal(sim: NominalSim, recorded: ObjectModel) -> Simulator:
    from tossid.diagnosis.simulators import nominal

    return nominal(recorded, gravity=sim.gravity)


def _mjcf(sim: MjcfSim, recorded: ObjectModel) -> Simulator:
    from tossid.diagnosis.simulators import read_simulator

    return read_simulator(sim.path, recorded)


def _run(sim: RunSim, recorded: ObjectModel) -> Simulator:
    """A trained run, named as the tracker has it."""
    from pipelines.tracking.runs import find_run
    from tossid.diagnosis.simulators import read_simulator

    record = find_run(sim.path)
    about = f"run {record.name}" + (f" ({record.id[:8]})" if record.id else "")
    return replace(read_simulator(record.trained_model(), recorded), about=about, run=record.id or None)


def _python(sim: PythonSim, recorded: ObjectModel) -> Simulator:
    from tossid.diagnosis.likelihood.simulator_process import FromFile
    from tossid.diagnosis.simulators import users_simulator

    if not sim.path.is_file():
        raise InputError(f"sim.path: there is no file {sim.path}; expected a Python file with your simulator")
    return users_simulator(FromFile(sim.path, sim.function), recorded, about=f"{sim.function} of {sim.path}")


_SIMULATORS: dict[str, Callable[[Any, ObjectModel], Simulator]] = {
    "nominal": _nominal,
    "mjcf": _mjcf,
    "run": _run,
    "python": _python,
}


def _dataset_name(data: Path) -> str:
    """The dataset's name: cube for data/datasets/cube.h5, cube-lcp-0 for data/raw/cube-lcp-0/tosses.h5."""
    return data.resolve().parent.name if data.name == "tosses.h5" else data.stem


def _say(found: Diagnosis, folder: Path, console: Console) -> None:
    """The diagnosis's card, and where the report is."""
    for line in str(found).splitlines():
        console.say(line)
    problem = ((found.patch or {}).get("rerun") or {}).get("problem")
    if problem:
        console.warn(f"the patch was not rerun in MuJoCo: {problem}")
    console.say(f"report: {folder / 'gap.html'}")
