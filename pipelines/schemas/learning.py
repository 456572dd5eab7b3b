"""Keys of `train` and `evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipelines.schemas.kinds import Count, NonNegative, Positive, Seed
from pipelines.schemas.launching import Launcher


@dataclass(frozen=True)
class ModelConfig:
    """What is learned and what is given."""

    name: Literal["cn", "cnrp", "cnrpi", "diffsim", "e2e"]
    """cn: geometry and friction; cnrp: and a residual acceleration; cnrpi: and inertia with centre of mass;
    diffsim: what cnrpi learns, by prediction error alone; e2e: a network from state to next velocity"""
    gravity: NonNegative
    """downward acceleration of the given continuous dynamics [m/s²]"""
    hidden: Count
    """width of the hidden layers (of the residual; of e2e's network)"""
    residual_weight: NonNegative
    """weight of the squared residual acceleration in the loss, but for its uniform vertical part"""
    complementarity: NonNegative
    """weight of impulses at a distance"""
    dissipation: NonNegative
    """weight of friction that does not oppose sliding"""
    penetration: NonNegative
    """weight of corners below the ground"""
    gap_scale: Positive
    """distance below which a gap counts quadratically [m]; the noise of the corners' heights"""
    horizons: tuple[Count, ...]
    """frames after first contact of the rollouts that refine friction, contact law and inertia; with joints, of
    stretches from everywhere in a toss, half the first and then the first long; []: no such stages"""
    inertia: Literal["log_cholesky", "triangular", "direct"]
    """parameterisation of a learned inertia"""
    start_inertia: Positive
    """inertia that training starts from, relative to the object's"""
    start_com: tuple[float, float, float]
    """shift of the centre of mass (of the base) that training starts from [m]"""
    start_corners: NonNegative
    """how far off the given corners are when training starts, along each axis, drawn by the seed [m]"""
    length_scale: Positive | Literal["auto"]
    """recorded length per true length; auto: as the training tosses at rest show it"""
    velocity_lag: NonNegative | Literal["auto"]
    """how much earlier recorded velocities are than their poses [s]; auto: as the training tosses' flight shows it"""


@dataclass(frozen=True)
class TrainConfig:
    """Fit a model to a dataset."""

    model: ModelConfig
    """the model"""
    data: Path | None
    """the dataset; null: the newest that ingest or synthesize wrote"""
    tosses: Count | None
    """learn from so many of the training tosses, and stop by at most as many others, drawn by the seed; null: all"""
    seed: Seed
    """seed of the residual's first weights"""
    epochs: Count
    """most epochs a stage"""
    patience: Count
    """epochs without a better validation loss before a stage ends"""
    optimizer: Literal["lbfgs", "adam"]
    """of the implicit loss"""
    learning_rate: Positive
    """Adam's"""
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


@dataclass(frozen=True)
class EvaluateConfig:
    """Roll a trained model out on held-out tosses, or run a study."""

    launcher: Launcher
    """a study: who computes its cells:"""
    sweep: SweepConfig | None
    """a study to run instead; '--sweep NAME' says the same:"""
    run: str | None
    """run id, name, folder, or models:/NAME/VERSION of the registry; null: the newest training"""
    data: Path | None
    """another dataset, judged on all its tosses; null: the held-out tosses of the run's own. A sweep: its dataset, else
    the newest"""


@dataclass(frozen=True)
class RegisterConfig:
    """A trained model under a name in MLflow's registry, as its next version."""

    name: str
    """the model's name; 'run=models:/NAME/VERSION' names it to other commands"""
    run: str | None
    """run id or name; null: the newest training"""
