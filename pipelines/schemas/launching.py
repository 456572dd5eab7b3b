"""Where a study's or an audit's work is done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pipelines.schemas.kinds import Count, Positive


@dataclass(frozen=True)
class ProcessesLauncher:
    """Processes of this machine, one a core unless told otherwise."""

    name: Literal["processes"]
    """processes"""


@dataclass(frozen=True)
class DaskLauncher:
    """The workers of a Dask scheduler that runs already; they see this machine's files under the same paths."""

    name: Literal["dask"]
    """a Dask scheduler"""
    address: str
    """the scheduler's address: tcp://HOST:PORT"""
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
    interface: str | None
    """network interface that jobs reach this machine by ("ib0"); null: the one of its name"""
    wait_s: Positive
    """how long to wait for the first job to start, and for another once none is left [s]"""


Launcher = ProcessesLauncher | DaskLauncher | SlurmLauncher
