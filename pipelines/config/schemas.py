"""The keys of every command, with their types and meanings.

`conf/COMMAND.yaml` names a command's default members, and holds what differs from the defaults here and in
`tossid.settings`. The first line under a class says what its command does, and the text under a field is the key's
documentation; `tossid COMMAND --help` prints both. A field whose type is a dataclass with a `name`, and that has a
folder in `conf/`, is a group: `source=tum` takes `conf/source/tum.yaml`. Where members differ in their keys, the field
is a union, or names a registry (`Registered`), and the member's `name` picks the class.

Nothing heavy is imported here: help pages read this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tossid.settings.audit import AuditSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.settings.evaluation import EvaluateSettings, ExportSettings
from tossid.settings.ingestion import DetectSettings, IngestSettings, TossSettings
from tossid.settings.kinds import Bounds, Count, NonNegative, Positive, Registered, Seed
from tossid.settings.limits import Friction, Gravity, Length, Mass, Restitution
from tossid.settings.objects import ObjectSettings, UnknownObjectSettings
from tossid.settings.synthesis import SynthesizeSettings
from tossid.settings.tracking import TrackSettings
from tossid.settings.training import TrainSettings


@dataclass(frozen=True)
class ProcessesLauncher:
    """Processes of this machine, one a core by default."""

    name: Literal["processes"]
    """processes"""


@dataclass(frozen=True)
class DaskLauncher:
    """The workers of a Dask scheduler that runs already; they see this machine's files under the same paths."""

    name: Literal["dask"]
    """a Dask scheduler"""
    address: str
    """the scheduler's address: tls://HOST:PORT, or tcp://HOST:PORT on this machine"""
    tls: Path | None
    """folder of cert.pem and key.pem, which the scheduler and its workers have too; null: as Dask's own configuration
    says"""
    insecure: bool
    """take a scheduler on another machine without TLS: whoever reaches its port can then run code as you"""
    wait_s: Positive
    """how long to wait for the scheduler and its first worker [s]"""


@dataclass(frozen=True)
class SlurmLauncher:
    """Jobs of a Slurm cluster, each a Dask worker with one core; started here and ended with the command."""

    name: Literal["slurm"]
    """Slurm jobs"""
    jobs: Count
    """how many"""
    queue: str | None
    """partition; null: the cluster's default"""
    account: str | None
    """account; null: the user's default"""
    memory: str
    """memory of a job"""
    walltime: str
    """longest time of a job, HH:MM:SS"""
    interface: str
    """network interface that jobs reach this machine by ("ib0"); the command listens there and nowhere else"""
    tls: bool
    """encrypt, and take only workers that hold the certificate that the command makes for them"""
    wait_s: Positive
    """how long to wait for the first job to start, and for another once none is left [s]"""


Launcher = ProcessesLauncher | DaskLauncher | SlurmLauncher


@dataclass(frozen=True, kw_only=True)
class SynthesizeConfig(SynthesizeSettings):
    """Make tosses with a simulator, and camera frames of them, with their truth beside."""

    object: ObjectSettings
    """what is tossed:"""
    frames: bool
    """camera frames (a recording for ingest), or states (a dataset for train)"""
    out: Path | None
    """folder to write; null: data/raw/OBJECT-ENGINE-SEED"""


def _sources() -> tuple[type, ...]:
    """The settings of every registered input format."""
    from tossid.vision.recordings.registry import input_formats

    return tuple(entry.settings for entry in input_formats().values())


Source = Annotated[Any, Registered(_sources)]
"""Settings of an input format: the member of `conf/source` chooses the format of its name."""


@dataclass(frozen=True, kw_only=True)
class IngestConfig(IngestSettings):
    """Turn raw recordings, tracked poses or published tosses into a dataset."""

    source: Source
    """what is read:"""
    object: ObjectSettings | UnknownObjectSettings | None
    """what was tossed; none: what the recording says, else the elbow for pll and the cube for the rest; unknown: the
    dataset states no object:"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/NAME.h5"""


@dataclass(frozen=True)
class DetectStageConfig:
    """Find the tags in a recording's frames (first stage of ingest)."""

    recording: Path | None
    """recording folder (frames or videos), or a bag with images; null: the newest in data/raw"""
    recordings: str | None
    """several, by a pattern ('data/raw/*'): each is searched by a worker, those that have been are left as they are"""
    out: Path | None
    """detections to write (.npz), of several a folder; null: outputs/stages/RECORDING/detections.npz"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    workers: Count | None
    """recordings at the same time, of several; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who searches several:"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else the cube:"""
    detect: DetectSettings = DetectSettings()
    """how tags are looked for:"""


@dataclass(frozen=True)
class TrackStageConfig:
    """Estimate the object's poses from detected tags (second stage of ingest)."""

    recording: Path | None
    """recording folder (for its calibration), or a bag with detections; null: the newest in data/raw"""
    detections: Path | None
    """what `tossid detect` wrote; null: the bag's, else its default place for this recording"""
    out: Path | None
    """poses to write (.npz, with .txt of each body in the TUM format and the calibration beside);
    null: outputs/stages/RECORDING/poses.npz"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else every moving body of tagslam.yaml:"""
    track: TrackSettings = TrackSettings()
    """when a pose is accepted:"""


@dataclass(frozen=True, kw_only=True)
class SegmentStageConfig(TossSettings):
    """Cut tracked poses into tosses and write the dataset (third stage of ingest)."""

    recording: Path | None
    """recording folder (for its object); null: the newest in data/raw"""
    poses: Path | None
    """what `tossid track` wrote; null: its default place for this recording"""
    out: Path | None
    """the dataset to write (.h5); null: data/datasets/RECORDING.h5"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says, else the cube:"""


@dataclass(frozen=True, kw_only=True)
class TrainConfig(TrainSettings):
    """Fit a model to a dataset; an interrupted training goes on where it was."""

    data: Path | None
    """the dataset; null: the newest that ingest or synthesize wrote"""
    restart: bool
    """start anew where an interrupted training of the same keys and data could go on"""


@dataclass(frozen=True)
class SweepConfig:
    """A study: a training and its evaluation for each model, each value of a key and each seed."""

    name: str
    """what it is called; its results lie in outputs/sweeps"""
    key: str
    """the key of train that is swept; it takes numbers"""
    values: tuple[float, ...]
    """its values"""
    models: tuple[str, ...]
    """the models, of conf/model; one may carry keys of its own: 'cn optimizer=adam'"""
    seeds: tuple[Seed, ...]
    """the seeds"""
    train: tuple[str, ...]
    """further keys of every training, as KEY=VALUE"""
    workers: Count | None
    """processes: trainings at the same time; null: one a core"""


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig(EvaluateSettings):
    """Roll a trained model out on held-out tosses and measure its errors; or run a study, with --sweep."""

    launcher: Launcher
    """a study: who computes its cells:"""
    sweep: SweepConfig | None
    """a study to run instead; '--sweep NAME' says the same:"""
    run: str | None
    """run id, name, folder, or models:/NAME/VERSION of the registry; null: the newest training"""
    data: Path | None
    """another dataset, of which all tosses are used; null: the held-out tosses of the run's own. A sweep: its dataset,
    else the newest"""


@dataclass(frozen=True)
class RegisterConfig:
    """Put a trained model under a name in MLflow's registry."""

    name: str
    """the model's name; 'run=models:/NAME/VERSION' names it to other commands"""
    run: str | None
    """run id or name; null: the newest training"""


@dataclass(frozen=True)
class NominalSim:
    """The dataset's object as it is stated, in tossid's own rigid contact."""

    name: Literal["nominal"]
    """the stated object"""
    gravity: Gravity
    """downward [m/s²]"""


@dataclass(frozen=True)
class RunSim:
    """A trained model: its object, gravity, residual and measurement."""

    name: Literal["run"]
    """a trained model"""
    path: str | None
    """run id, name or folder; null: the newest training"""


@dataclass(frozen=True)
class MjcfSim:
    """Your own MuJoCo model; what the diagnosis finds is also applied to it and rerun in MuJoCo."""

    name: Literal["mjcf"]
    """a MuJoCo model"""
    path: Path
    """its MJCF file: one free body, and the ground as a plane"""


@dataclass(frozen=True)
class PythonSim:
    """Your own simulator, a Python function f(q0, v0, n_steps, dt) -> (q, v); it runs in a process of its own."""

    name: Literal["python"]
    """a Python function"""
    path: Path
    """its file"""
    function: str
    """its name"""


Sim = NominalSim | RunSim | MjcfSim | PythonSim


@dataclass(frozen=True, kw_only=True)
class DiagnoseConfig(DiagnoseSettings):
    """Say where a simulator misses the tosses, which effect causes it, and how far that closes the gap."""

    sim: Sim
    """the simulator that is diagnosed:"""
    data: Path | None
    """the dataset; null: the newest"""
    out: Path | None
    """folder of the report; null: outputs/diagnose/DATASET-SIM"""


@dataclass(frozen=True, kw_only=True)
class AuditConfig(AuditSettings):
    """Check diagnose on tosses whose effect is withheld from it; an interrupted audit goes on."""

    object: ObjectSettings
    """what is tossed"""
    out: Path | None
    """folder of the audit; null: outputs/audit/SEED"""
    workers: Count | None
    """cases at the same time; null: one a core, or as many as the cluster has workers"""
    launcher: Launcher
    """who computes the cases:"""


@dataclass(frozen=True)
class ViewConfig:
    """Show a recording, dataset, run or gap in 3D (a Rerun file), or a recording as a contact sheet."""

    recording: Path | None
    """recording to show (frames, videos, or a bag); null, with no data=, run= or gap=: the newest in data/raw"""
    data: Path | None
    """dataset to show (.h5)"""
    run: str | None
    """training whose rollouts to show beside held-out tosses (id, name or folder), or those of data="""
    gap: Path | None
    """what `tossid diagnose` wrote (folder or gap.json): its tosses, and rollouts as stated and as patched"""
    detections: Path | None
    """what `tossid detect` wrote for the recording; null: its default place, else tags are looked for now"""
    poses: Path | None
    """what `tossid track` wrote for it; null: its default place, else it is tracked now"""
    out: Path | None
    """Rerun file to write (.rrd); null: outputs/view/NAME.rrd, unless a sheet is asked for"""
    sheet: Path | None
    """contact sheet of the recording to write (.png), for which Rerun is not needed; null: none"""
    open: bool
    """open the Rerun file in its viewer"""
    start_s: NonNegative
    """skip so much at the beginning [s]"""
    seconds: Positive | None
    """show so much from there [s]; null: all"""
    every: Count | None
    """each so many-th frame's image; null: so that there are at most 500"""
    moments: Annotated[int, Bounds(low=1, high=40)]
    """columns of the contact sheet"""
    magnify: Positive
    """covariances are drawn at three standard deviations, so many times as large"""
    threads: Count | None
    """images searched at the same time; null: one a core"""
    object: ObjectSettings | None
    """what was tossed; none: what the recording says:"""
    detect: DetectSettings = DetectSettings()
    """how tags are looked for:"""
    track: TrackSettings = TrackSettings()
    """when a pose is accepted:"""


@dataclass(frozen=True, kw_only=True)
class ExportConfig(ExportSettings):
    """Write a learned model as MJCF or URDF, and compare MuJoCo's rollouts of it with tossid's."""

    run: str | None
    """run id, name or folder; null: the newest training"""
    out: Path | None
    """file to write (.xml, .urdf); null: outputs/export/NAME"""


@dataclass(frozen=True)
class NewObjectConfig:
    """Make an object from a box, with a tag on each face and a sheet to print the tags from."""

    name: str
    """what it is called"""
    box: tuple[Length, Length, Length]
    """its edges along x, y and z [m]"""
    mass: Mass
    """its mass [kg]"""
    com: tuple[float, float, float]
    """its centre of mass, from the box's centre [m]"""
    friction: Friction
    """Coulomb friction of object and ground, as far as you know it"""
    restitution: Restitution
    """Newton's restitution, 0 for none"""
    tag_size: Positive | None
    """edge of the tags' black border [m]; null: three quarters of what each face has room for"""
    first_id: Annotated[int, Bounds(low=0, high=581)]
    """id of the first tag (36h11); six are used, on +x, -x, +y, -y, +z, -z"""
    paper: Literal["a4", "letter"]
    """what the sheet is printed on"""
    out: Path | None
    """folder that gets object/NAME.xml, object/NAME.yaml, tags/NAME.yaml and tags/NAME.pdf; null: conf, where
    object=NAME finds it"""


COMMANDS: dict[str, type] = {
    "synthesize": SynthesizeConfig,
    "ingest": IngestConfig,
    "detect": DetectStageConfig,
    "track": TrackStageConfig,
    "segment": SegmentStageConfig,
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "register": RegisterConfig,
    "diagnose": DiagnoseConfig,
    "audit": AuditConfig,
    "export": ExportConfig,
    "view": ViewConfig,
    "new-object": NewObjectConfig,
}
"""The schema of each command that takes keys, in the order of the help page."""
